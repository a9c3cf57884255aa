"""One picture of a map from above: trajectories, landmarks by class, loop closures."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from logs.container.names import visible
from logs.storage.placement import replacing
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.display.map_layers import Layer, MapPicture

_INK, _MUTED, _GRID = "#1f2937", "#4b5563", "#e5e7eb"


def draw_map(path_png: str | Path, picture: MapPicture) -> None:
    """Draw a map from above into a PNG file, by way of ``NAME.part``: x to the right, y up, equal scales.

    The same picture gives the same bytes.

    Raises:
        EvaluationError: there is nothing to draw.
        UnwritableLogError: the file cannot be written.
    """
    figure, png = _compose(picture), BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of letters that are in no font
        figure.savefig(png, format="png", dpi=figure.dpi, metadata={"Software": None})  # no version of matplotlib
    with replacing(path_png) as part:
        part.write_bytes(png.getvalue())


def _compose(picture: MapPicture) -> Figure:
    layers = [layer for layer in picture.layers if len(layer.positions)]
    if not layers:
        raise EvaluationError("no position to draw")
    low, high = _limits(np.concatenate([layer.positions for layer in layers])[:, :2])
    # A dollar sign in a name is one.
    with rc_context({"text.parse_math": False}):
        height_in = float(min(12.2 * (high - low)[1] / (high - low)[0] + 1.5, 16.0))
        figure = Figure(figsize=(16.0, height_in), dpi=100.0, facecolor="white")
        figure.set_layout_engine("constrained", h_pad=0.15, w_pad=0.15)
        axes = figure.add_subplot()
        _prepare(axes, low, high)
        for number, layer in enumerate(layers, start=2):  # above the grid
            _draw(axes, layer, number)
        figure.legend(loc="outside right upper", fontsize=13, frameon=False, labelcolor=_INK)
        axes.set_title(_cut(picture.title, 60), loc="left", fontsize=20, fontweight="bold", color=_INK, pad=30)
        place: dict[str, Any] = {"xycoords": "axes fraction", "xytext": (0.0, 6.0), "textcoords": "offset points"}
        axes.annotate(picture.subtitle, (0.0, 1.0), **place, fontsize=13, color=_MUTED)
    return figure


def _limits(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    margin = max(0.03 * np.max(high - low), 1.0)
    low, high = low - margin, high + margin
    # A straight street must not become a strip: the short side is widened to half of the long one.
    missing = np.maximum(0.5 * np.max(high - low) - (high - low), 0.0)
    return low - 0.5 * missing, high + 0.5 * missing


def _prepare(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    axes.set_xlabel("x [m]", fontsize=13, color=_INK)
    axes.set_ylabel("y [m]", fontsize=13, color=_INK)
    axes.tick_params(labelsize=12, colors=_MUTED, length=0)
    axes.grid(visible=True, color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[:].set_visible(False)


def _draw(axes: Axes, layer: Layer, zorder: int) -> None:
    name = _cut(layer.name, 40) + ("" if layer.count is None else f" ({layer.count})")
    if name.startswith("_"):
        name = f" {name}"  # the key leaves out what begins with an underscore
    x, y = layer.positions[:, :2].T
    if layer.size:
        edge: dict[str, Any] = {"linewidths": 0.07 * layer.size, "edgecolors": "white"}
        axes.scatter(x, y, s=layer.size**2, c=layer.color, marker=layer.marker, zorder=zorder, label=name, **edge)
    else:
        style = (0, (6, 4)) if layer.is_dashed else "-"
        axes.plot(x, y, color=layer.color, linewidth=layer.width, linestyle=style, zorder=zorder, label=name)


def _cut(name: str, most: int) -> str:
    """As many letters of a name as have room."""
    text = visible(name).replace("\n", " ")
    return text if len(text) <= most else f"{text[: most - 1]}…"
