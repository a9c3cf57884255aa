"""One picture of a map from above: trajectories, landmarks by class, loop closures."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from logs.container.names import visible
from logs.errors import UnwritableLogError
from logs.storage.placement import put_in_place
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.visualization.palette import (
    CLOSURE,
    END,
    ESTIMATE,
    FALSE_CLOSURE,
    FOUND,
    LEGEND_CLASSES,
    LOST,
    MISSED,
    ODOMETRY,
    OTHER_COLOR,
    START,
    TRUE_CLOSURE,
    TRUTH,
    class_hex,
    group_classes,
    lift_pen,
)

_LineStyle = Literal["-"] | tuple[float, tuple[float, float]]

_INK, _GRID, _KNOWN = "#1f2937", "#e5e7eb", "#9ca3af"
_MARKERS = "os^DvPXhp*<>"
_LONGEST_NAME = 40


def _nowhere() -> FloatArray:
    return np.zeros((0, 3))


def _no_rows() -> IntArray:
    return np.zeros(0, dtype=np.int64)


def _no_line() -> FloatArray:
    return np.zeros((0, 2, 3))


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """What to draw, all in metres and in one frame (the map, into which the caller has aligned the others).

    estimate, odometry, truth (N, 3) positions along the path, N may be 0; landmarks (L, 3) with ``labels`` (L,);
    closures, true_closures, false_closures (C, 2, 3) ends of accepted loop closures of which it is unknown whether they
    are right, that are, that are not; missed_revisits (M, 3) where a closure was possible and not made; lost, found
    (J, 3) where the robot lost and found its place; estimate_jumps, odometry_jumps, truth_jumps: rows after which a
    path jumps, for example because the robot was carried away, and no line is drawn; known (K, 3) landmarks of a map
    that was given, drawn in grey; errors of estimate and odometry where they are known.
    """

    estimate: FloatArray
    odometry: FloatArray = field(default_factory=_nowhere)
    truth: FloatArray = field(default_factory=_nowhere)
    landmarks: FloatArray = field(default_factory=_nowhere)
    labels: tuple[str, ...] = ()
    closures: FloatArray = field(default_factory=_no_line)
    true_closures: FloatArray = field(default_factory=_no_line)
    false_closures: FloatArray = field(default_factory=_no_line)
    missed_revisits: FloatArray = field(default_factory=_nowhere)
    lost: FloatArray = field(default_factory=_nowhere)
    found: FloatArray = field(default_factory=_nowhere)
    estimate_jumps: IntArray = field(default_factory=_no_rows)
    odometry_jumps: IntArray = field(default_factory=_no_rows)
    truth_jumps: IntArray = field(default_factory=_no_rows)
    known: FloatArray = field(default_factory=_nowhere)
    title: str = "Object map"
    ate_m: float | None = None
    odometry_ate_m: float | None = None


def draw_map(path_png: str | Path, picture: MapPicture, *, width_px: int = 1600) -> None:
    """Draw a map from above (x to the right, y up, equal scales) into a PNG file.

    The ``LEGEND_CLASSES`` most frequent classes have a colour and a marker each, ties by name; the rest is "other".

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
    shown = (picture.estimate, picture.odometry, picture.truth, picture.landmarks, picture.known)
    points = np.concatenate(shown)[:, :2]
    if len(points) == 0 or not np.isfinite(points).all():
        raise EvaluationError("no position to draw" if len(points) == 0 else "a position to be drawn is not finite")
    low, high = _limits(points)
    with rc_context({"text.parse_math": False}):  # a dollar sign in a name is one
        _draw(Path(path_png), picture, low, high, width_px)


def _draw(path_png: Path, picture: MapPicture, low: FloatArray, high: FloatArray, width_px: int) -> None:
    figure = Figure(figsize=(16.0, _height_in(low, high)), dpi=width_px / 16.0, facecolor="white", layout="constrained")
    axes = figure.add_subplot()
    _prepare(axes, low, high)
    landmark_handles = [*_draw_known(axes, picture), *_draw_landmarks(axes, picture)]
    handles = [*_draw_paths(axes, picture), *landmark_handles]
    figure.legend(handles=handles, loc="outside right upper", fontsize=13, frameon=False, labelcolor=_INK)
    axes.set_title(picture.title, loc="left", fontsize=20, fontweight="bold", color=_INK, pad=30)
    axes.annotate(
        _subtitle(picture),
        (0.0, 1.0),
        xycoords="axes fraction",
        xytext=(0.0, 6.0),
        textcoords="offset points",
        fontsize=13,
        color="#4b5563",
    )
    save_figure(figure, path_png)


def _limits(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.03 * float(np.max(high - low)), 1.0)
    low, high = low - margin, high + margin
    # A straight street must not become a strip: the short side is widened to half of the long one.
    missing = np.maximum(0.5 * np.max(high - low) - (high - low), 0.0)
    return low - 0.5 * missing, high + 0.5 * missing


def _height_in(low: FloatArray, high: FloatArray) -> float:
    """Height for a picture 16 inches wide, of which the legend takes about 3 and headings and ticks about 1.5."""
    span = high - low
    return float(min(12.2 * span[1] / span[0] + 1.5, 16.0))


def _prepare(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    axes.set_xlabel("x [m]", fontsize=13, color=_INK)
    axes.set_ylabel("y [m]", fontsize=13, color=_INK)
    axes.tick_params(labelsize=12, colors="#4b5563", length=0)
    axes.grid(visible=True, color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _draw_known(axes: Axes, picture: MapPicture) -> list[Line2D]:
    """Draw the landmarks of a given map under everything, and return the legend's entry."""
    if not len(picture.known):
        return []
    x, y = picture.known[:, :2].T
    axes.scatter(x, y, s=float(np.clip(12000.0 / len(x), 24.0, 70.0)), color=_KNOWN, linewidths=0.0, zorder=1.5)
    return [_marker("o", _KNOWN, 10.0, f"landmarks of the map ({len(x)})")]


def _draw_landmarks(axes: Axes, picture: MapPicture) -> list[Line2D]:
    """Draw the landmarks and return the legend's entries."""
    # A thousand landmarks need smaller markers than ten.
    size = float(np.clip(12000.0 / max(len(picture.labels), 1), 24.0, 70.0))
    handles = []
    for index, (name, rows) in enumerate(group_classes(picture.labels)):
        # "other" comes after all classes that have a colour.
        color, marker = (OTHER_COLOR, "o") if index == LEGEND_CLASSES else (class_hex(name), _MARKERS[index])
        x, y = picture.landmarks[rows, :2].T
        axes.scatter(x, y, s=size, marker=marker, color=color, edgecolors="white", linewidths=0.4, zorder=2.0)
        handles.append(_marker(marker, color, 10.0, f"{_entry(name)} ({len(rows)})"))
    return handles


def _draw_paths(axes: Axes, picture: MapPicture) -> list[Line2D]:
    """Draw trajectories, closures, start and end, and return the legend's entries."""
    handles = []
    estimate = lift_pen(picture.estimate, picture.estimate_jumps)
    odometry = lift_pen(picture.odometry, picture.odometry_jumps)
    truth = lift_pen(picture.truth, picture.truth_jumps)
    paths: tuple[tuple[FloatArray, str, str, float, _LineStyle, float], ...] = (
        (estimate, "estimate", ESTIMATE, 2.8, "-", 4.0),
        (odometry, "odometry", ODOMETRY, 1.6, "-", 3.0),
        (truth, "ground truth", TRUTH, 1.2, (0, (6, 4)), 4.5),
    )
    for positions, name, color, width, style, zorder in paths:
        if len(positions):
            x, y = positions[:, :2].T
            axes.plot(x, y, color=color, linewidth=width, linestyle=style, zorder=zorder)
            handles.append(Line2D([], [], color=color, linewidth=width, linestyle=style, label=name))
    handles += [*_draw_closures(axes, picture), *_draw_losses(axes, picture)]
    shown = next(
        (positions for positions in (picture.estimate, picture.truth, picture.odometry) if len(positions)), None
    )
    if shown is not None:
        for point, marker, color, name in ((shown[0], "o", START, "start"), (shown[-1], "s", END, "end")):
            mark = _marker(marker, color, 13.0, name)
            mark.set_data([point[0]], [point[1]])
            mark.set_zorder(6.0)
            axes.add_line(mark)
            handles.append(_marker(marker, color, 13.0, name))
    return handles


def _draw_closures(axes: Axes, picture: MapPicture) -> list[Line2D]:
    """Draw closures, the false ones above all, and missed revisits, and return the legend's entries."""
    handles = []
    if len(picture.missed_revisits):
        x, y = picture.missed_revisits[:, :2].T
        axes.scatter(x, y, s=30.0, marker="o", facecolors="white", edgecolors=MISSED, linewidths=1.4, zorder=4.8)
        mark = _marker("o", "white", 7.0, f"missed revisits ({len(picture.missed_revisits)})")
        mark.set(markeredgecolor=MISSED, markeredgewidth=1.4)
        handles.append(mark)
    for lines, name, color, width, zorder in (
        (picture.closures, "loop closures", CLOSURE, 1.6, 5.0),
        (picture.true_closures, "true loop closures", TRUE_CLOSURE, 1.6, 5.0),
        (picture.false_closures, "false loop closures", FALSE_CLOSURE, 4.0, 7.0),
    ):
        if len(lines):
            collection = LineCollection(list(lines[:, :, :2]), colors=color, linewidths=width, zorder=zorder)
            axes.add_collection(collection, autolim=False)
            handles.append(Line2D([], [], color=color, linewidth=width, label=f"{name} ({len(lines)})"))
    return handles


def _draw_losses(axes: Axes, picture: MapPicture) -> list[Line2D]:
    """Draw where the robot lost and found its place, and return the legend's entries."""
    handles = []
    for places, name, marker, color in (
        (picture.lost, "lost", "v", LOST),
        (picture.found, "found again", "^", FOUND),
    ):
        if len(places):
            x, y = places[:, :2].T
            axes.scatter(x, y, s=180.0, marker=marker, color=color, edgecolors="white", linewidths=1.2, zorder=6.5)
            handles.append(_marker(marker, color, 12.0, f"{name} ({len(places)})"))
    return handles


def _marker(marker: str, color: str, size: float, label: str) -> Line2D:
    return Line2D(
        [],
        [],
        linestyle="none",
        marker=marker,
        markersize=size,
        markerfacecolor=color,
        markeredgecolor="white",
        markeredgewidth=0.1 * size,
        label=label,
    )


def _entry(name: str) -> str:
    """A class in the legend, from which the library leaves out what begins with an underscore."""
    text = visible(name).replace("\n", " ")
    text = f" {text}" if text.startswith("_") else text
    return text if len(text) <= _LONGEST_NAME else f"{text[: _LONGEST_NAME - 3]}..."


def _subtitle(picture: MapPicture) -> str:
    parts = []
    for positions, name in ((picture.estimate, "path"), (picture.odometry, "odometry")):
        if len(positions):
            length = np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
            parts.append(f"{name} {length:.0f} m")
            break
    if picture.labels:
        parts.append(f"landmarks {len(picture.labels)}, classes {len(set(picture.labels))}")
    if picture.ate_m is not None:
        parts.append(f"ATE {picture.ate_m:.2f} m")
    if picture.odometry_ate_m is not None:
        parts.append(f"odometry alone {picture.odometry_ate_m:.2f} m")
    return "   ·   ".join(parts)


def save_figure(figure: Figure, target: Path) -> None:
    """Write a PNG, whole or not at all.

    Raises:
        UnwritableLogError: it cannot be written.
    """
    part = target.with_name(target.name + ".part")
    try:
        with part.open("wb") as file, warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph", UserWarning)  # of a name; a box stands for it
            # Without the library's version the same map gives the same bytes.
            figure.savefig(file, format="png", dpi=figure.dpi, metadata={"Software": None})
        put_in_place(part, target)
    except OSError as error:
        raise UnwritableLogError(f"cannot write {target}: {error.strerror or error}") from error
