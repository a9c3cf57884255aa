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
from slam.display.map_layers import Layer, MapPicture, layers_of

_INK, _MUTED, _GRID = "#1f2937", "#4b5563", "#e5e7eb"
_MAX_NAME_LENGTH, _MAX_TITLE_LENGTH = 40, 60
"""Letters that have room in the key and above the map."""


def draw_map(path_png: str | Path, picture: MapPicture) -> None:
    """Draw a map from above into a PNG file, by way of ``NAME.part``.

    Raises:
        EvaluationError: as :func:`compose_map`.
        UnwritableLogError: the file cannot be written.
    """
    save_figure(compose_map(picture), Path(path_png))


def compose_map(picture: MapPicture) -> Figure:
    """A map from above: x to the right, y up, equal scales.

    Raises:
        EvaluationError: there is nothing to draw.
    """
    points = picture.points[:, :2]
    if len(points) == 0:
        raise EvaluationError("no position to draw")
    low, high = _limits(points)
    # A dollar sign in a name is one.
    with rc_context({"text.parse_math": False}):
        height_in = float(min(12.2 * (high - low)[1] / (high - low)[0] + 1.5, 16.0))
        figure = Figure(figsize=(16.0, height_in), dpi=100.0, facecolor="white")
        figure.set_layout_engine("constrained", h_pad=0.15, w_pad=0.15)
        axes = figure.add_subplot()
        _prepare(axes, low, high)
        for number, layer in enumerate(layers_of(picture), start=2):  # above the grid
            _draw(axes, layer, number)
        figure.legend(loc="outside right upper", fontsize=13, frameon=False, labelcolor=_INK)
        axes.set_title(
            _cut(picture.title, _MAX_TITLE_LENGTH), loc="left", fontsize=20, fontweight="bold", color=_INK, pad=30
        )
        place: dict[str, Any] = {"xycoords": "axes fraction", "xytext": (0.0, 6.0), "textcoords": "offset points"}
        axes.annotate(_subtitle(picture), (0.0, 1.0), **place, fontsize=13, color=_MUTED)
    return figure


def save_figure(figure: Figure, target: Path) -> None:
    """Write a PNG, whole or not at all.

    Raises:
        UnwritableLogError: it cannot be written.
    """
    with replacing(target) as part:
        part.write_bytes(to_png(figure))


def to_png(figure: Figure) -> bytes:
    """The figure as the bytes of a PNG; the same figure gives the same bytes."""
    png = BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of letters that are in no font
        figure.savefig(png, format="png", dpi=figure.dpi, metadata={"Software": None})  # no version of matplotlib
    return png.getvalue()


def _limits(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.03 * float(np.max(high - low)), 1.0)
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
    name = _cut(layer.name, _MAX_NAME_LENGTH) + ("" if layer.count is None else f" ({layer.count})")
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
    text = visible(name).replace("\n", " ")
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _subtitle(picture: MapPicture) -> str:
    parts = []
    if picture.length_m is not None:
        parts.append(f"path {picture.length_m:.0f} m")
    if picture.labels:
        parts.append(f"landmarks {len(picture.labels)}, classes {len(set(picture.labels))}")
    if picture.ate_m is not None:
        parts.append(f"ATE {picture.ate_m:.3f} m")
    if picture.odometry_ate_m is not None:
        parts.append(f"odometry alone {picture.odometry_ate_m:.3f} m")
    return "   ·   ".join(parts)
