"""One picture of a map from above: trajectories, landmarks by class, loop closures."""

from __future__ import annotations

import logging
import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import findSystemFonts, fontManager

from logs.container.names import visible
from logs.storage.placement import replacing
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.display import palette

_INK, _MUTED, _GRID, _KNOWN = "#1f2937", "#4b5563", "#e5e7eb", "#9ca3af"
_MARKERS = "os^DvPXhp*<>"
_MAX_NAME_LENGTH, _MAX_TITLE_LENGTH = 40, 60
"""Letters that have room in the key and above the map."""
_FONTS = ("DejaVu Sans", "Noto Sans CJK SC", "Noto Sans CJK JP", "WenQuanYi Zen Hei", "Droid Sans Fallback", "Unifont")
"""The first that has a letter draws it; those after the first, where they are installed, have Chinese ones."""


# That a fallback font has no bold face is nothing to tell anybody.
logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)


def _no_points() -> FloatArray:
    return np.zeros((0, 3))


def _no_lines() -> FloatArray:
    return np.zeros((0, 2, 3))


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """What to draw, all in metres and in one frame (the map, into which the caller has aligned the others).

    estimate, odometry, truth (N, 3) positions along the path, N may be 0, a row of NaN where no line is to be drawn;
    landmarks (L, 3) with ``labels`` (L,); closures, true_closures, false_closures (C, 2, 3) ends of accepted loop
    closures of which it is unknown whether they are right, that are, that are not; missed_revisits (M, 3) where a
    closure was possible and not made; lost, found (J, 3) where the robot lost and found its place; known (K, 3)
    landmarks of a map that was given, drawn in grey; errors of estimate and odometry where they are known.
    """

    estimate: FloatArray
    odometry: FloatArray = field(default_factory=_no_points)
    truth: FloatArray = field(default_factory=_no_points)
    landmarks: FloatArray = field(default_factory=_no_points)
    labels: tuple[str, ...] = ()
    closures: FloatArray = field(default_factory=_no_lines)
    true_closures: FloatArray = field(default_factory=_no_lines)
    false_closures: FloatArray = field(default_factory=_no_lines)
    missed_revisits: FloatArray = field(default_factory=_no_points)
    lost: FloatArray = field(default_factory=_no_points)
    found: FloatArray = field(default_factory=_no_points)
    known: FloatArray = field(default_factory=_no_points)
    title: str = "Object map"
    ate_m: float | None = None
    odometry_ate_m: float | None = None

    @property
    def points(self) -> FloatArray:
        """Everything that has to be in sight (N, 3), metres."""
        every = np.concatenate([self.estimate, self.odometry, self.truth, self.landmarks, self.known])
        return np.asarray(every[~np.isnan(every).all(axis=1)])


def draw_map(path_png: str | Path, picture: MapPicture, *, width_px: int = 1600) -> None:
    """Draw a map from above (x to the right, y up, equal scales) into a PNG file.

    The most frequent classes have a colour and a marker each, ties by name; the rest is "other".

    Args:
        path_png: file to write, by way of ``NAME.part``.
        picture: what to draw.
        width_px: width of the picture; its height follows from the map, at most one width.

    Raises:
        EvaluationError: there is nothing to draw, a position is not finite, or labels and landmarks differ in number.
        UnwritableLogError: the file cannot be written.
    """
    if len(picture.landmarks) != len(picture.labels):
        raise EvaluationError(f"{len(picture.landmarks)} landmarks have {len(picture.labels)} labels")
    points = picture.points[:, :2]
    if len(points) == 0 or not np.isfinite(points).all():
        raise EvaluationError("no position to draw" if len(points) == 0 else "a position to be drawn is not finite")
    low, high = _limits(points)
    # A dollar sign in a name is one.
    with rc_context({"text.parse_math": False, "font.family": _fonts() or ["sans-serif"]}):
        height_in = float(min(12.2 * (high - low)[1] / (high - low)[0] + 1.5, 16.0))
        figure = Figure(figsize=(16.0, height_in), dpi=width_px / 16.0, facecolor="white")
        figure.set_layout_engine("constrained", h_pad=0.15, w_pad=0.15)
        axes = figure.add_subplot()
        _prepare(axes, low, high)
        _draw_landmarks(axes, picture)
        _draw_paths(axes, picture)
        figure.legend(loc="outside right upper", fontsize=13, frameon=False, labelcolor=_INK)
        axes.set_title(
            _cut(picture.title, _MAX_TITLE_LENGTH), loc="left", fontsize=20, fontweight="bold", color=_INK, pad=30
        )
        place: dict[str, Any] = {"xycoords": "axes fraction", "xytext": (0.0, 6.0), "textcoords": "offset points"}
        axes.annotate(_subtitle(picture), (0.0, 1.0), **place, fontsize=13, color=_MUTED)
        save_figure(figure, Path(path_png))


def _fonts() -> list[str]:
    """Those of ``_FONTS`` that are installed, also since matplotlib first listed the fonts of this machine."""
    for path in sorted(set(findSystemFonts()) - {entry.fname for entry in fontManager.ttflist}):
        with suppress(OSError, RuntimeError):  # no font that matplotlib can read
            fontManager.addfont(path)
    installed = set(fontManager.get_font_names())
    return [name for name in _FONTS if name in installed]


def save_figure(figure: Figure, target: Path) -> None:
    """Write a PNG, whole or not at all.

    Raises:
        UnwritableLogError: it cannot be written.
    """
    with replacing(target) as part, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)  # of a name; a box stands for it
        # Without the library's version the same map gives the same bytes.
        figure.savefig(part, format="png", dpi=figure.dpi, metadata={"Software": None})


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


def _draw_points(
    axes: Axes, points: FloatArray, name: str, color: str, marker: str, size: float, zorder: float, edge: str = "white"
) -> None:
    if len(points):
        x, y = points[:, :2].T
        width = 0.07 * size**0.5 if edge == "white" else 1.4
        axes.scatter(
            x, y, s=size, marker=marker, color=color, edgecolors=edge, linewidths=width, zorder=zorder, label=name
        )


def _draw_landmarks(axes: Axes, picture: MapPicture) -> None:
    # A thousand landmarks need smaller markers than ten.
    size = float(np.clip(12000.0 / max(len(picture.labels), len(picture.known), 1), 24.0, 70.0))
    _draw_points(axes, picture.known, f"landmarks of the map ({len(picture.known)})", _KNOWN, "o", size, 1.5)
    for group in palette.group_classes(picture.labels):
        name = f"{_entry(group.name)} ({len(group.rows)})"
        marker = "o" if group.index < 0 else _MARKERS[group.index]
        _draw_points(axes, picture.landmarks[group.rows], name, group.color, marker, size, 2.0)


def _draw_paths(axes: Axes, picture: MapPicture) -> None:
    """Draw trajectories, closures (only false ones over them), missed revisits, losses, start and end."""
    for positions, name, color, width, style, zorder in (
        (picture.estimate, "estimate", palette.ESTIMATE, 2.8, "-", 4.0),
        (picture.odometry, "odometry", palette.ODOMETRY, 1.6, "-", 3.0),
        (picture.truth, "ground truth", palette.TRUTH, 1.2, (0, (6, 4)), 4.5),
    ):
        if len(positions):
            axes.plot(*positions[:, :2].T, color=color, linewidth=width, linestyle=style, zorder=zorder, label=name)
    missed = picture.missed_revisits
    _draw_points(axes, missed, f"missed revisits ({len(missed)})", "white", "o", 30.0, 4.8, palette.MISSED)
    for lines, name, color, width, zorder in (
        (picture.closures, "loop closures", palette.CLOSURE, 1.2, 1.8),
        (picture.true_closures, "true loop closures", palette.TRUE_CLOSURE, 1.6, 3.5),
        (picture.false_closures, "false loop closures", palette.FALSE_CLOSURE, 4.0, 7.0),
    ):
        if len(lines):
            strokes = LineCollection(
                list(lines[:, :, :2]), colors=color, linewidths=width, zorder=zorder, label=f"{name} ({len(lines)})"
            )
            axes.add_collection(strokes, autolim=False)
    _draw_points(axes, picture.lost, f"lost ({len(picture.lost)})", palette.LOST, "v", 180.0, 6.5)
    _draw_points(axes, picture.found, f"found ({len(picture.found)})", palette.FOUND, "^", 180.0, 6.5)
    shown = next((path for path in (picture.estimate, picture.truth, picture.odometry) if len(path)), _no_points())
    _draw_points(axes, shown[:1], "start", palette.START, "o", 170.0, 6.0)
    _draw_points(axes, shown[-1:], "end", palette.END, "s", 170.0, 6.0)


def _entry(name: str) -> str:
    """A class in the legend, from which the library leaves out what begins with an underscore."""
    text = _cut(name, _MAX_NAME_LENGTH)
    return f" {text}" if text.startswith("_") else text


def _cut(name: str, most: int) -> str:
    text = visible(name).replace("\n", " ")
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _subtitle(picture: MapPicture) -> str:
    parts = []
    for positions, name in ((picture.estimate, "path"), (picture.odometry, "odometry")):
        if len(positions):
            parts.append(f"{name} {np.nansum(np.linalg.norm(np.diff(positions, axis=0), axis=1)):.0f} m")
            break
    if picture.labels:
        parts.append(f"landmarks {len(picture.labels)}, classes {len(set(picture.labels))}")
    if picture.ate_m is not None:
        parts.append(f"ATE {picture.ate_m:.3f} m")
    if picture.odometry_ate_m is not None:
        parts.append(f"odometry alone {picture.odometry_ate_m:.3f} m")
    return "   ·   ".join(parts)
