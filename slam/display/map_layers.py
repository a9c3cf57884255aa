"""Lines and marks of a picture of a map, with names and colours, in the order of drawing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from logs.scene import CLASS_COLORS
from slam.common.arrays import FloatArray

ESTIMATE, ODOMETRY, TRUTH = "#0b5cad", "#d97706", "#6b7280"
TRUE_CLOSURE, FALSE_CLOSURE, UNDECIDED_CLOSURE = "#14b8a6", "#ff0000", "#d6249f"
CLASS_MARKERS = "os^DvPXhp*<>"
"""As matplotlib names them."""
OTHER, OTHER_COLOR = "other", "#9ca3af"


def _no_points() -> FloatArray:
    return np.zeros((0, 3))


def _no_lines() -> FloatArray:
    return np.zeros((0, 2, 3))


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """The content of a picture, in metres and in one frame (the map, into which the caller has aligned the others).

    estimate, odometry, truth (N, 3) positions along the path, N may be 0, a row of NaN where no line is to be drawn;
    landmarks (L, 3) with ``labels`` (L,); closures, true_closures, false_closures (C, 2, 3) ends of accepted loop
    closures that are undecided, true, false; lost, found (J, 3) where the robot lost and found its place; known (K, 3)
    landmarks of a map that was given, drawn in grey; length of the path, and errors of estimate and
    odometry, where they are known.
    """

    estimate: FloatArray
    odometry: FloatArray = field(default_factory=_no_points)
    truth: FloatArray = field(default_factory=_no_points)
    landmarks: FloatArray = field(default_factory=_no_points)
    labels: tuple[str, ...] = ()
    closures: FloatArray = field(default_factory=_no_lines)
    true_closures: FloatArray = field(default_factory=_no_lines)
    false_closures: FloatArray = field(default_factory=_no_lines)
    lost: FloatArray = field(default_factory=_no_points)
    found: FloatArray = field(default_factory=_no_points)
    known: FloatArray = field(default_factory=_no_points)
    title: str = "Object map"
    length_m: float | None = None
    ate_m: float | None = None
    odometry_ate_m: float | None = None

    @property
    def points(self) -> FloatArray:
        """Points (N, 3) m that the picture has to contain."""
        every = np.concatenate([self.estimate, self.odometry, self.truth, self.landmarks, self.known])
        return np.asarray(every[~np.isnan(every).all(axis=1)])


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One entry of the key: positions (N, 3) m joined by a line of some ``width``, broken at NaN, or marked.

    ``size``: diameter of the marks; 0 for a line. ``marker``: as matplotlib names it. ``count``: in brackets after the
    name; None for what there is one of.
    """

    name: str
    positions: FloatArray
    color: str
    width: float = 0.0
    is_dashed: bool = False
    size: float = 0.0
    marker: str = "o"
    count: int | None = None


def layers_of(picture: MapPicture) -> list[Layer]:
    """The layers that are not empty, in the order of drawing: false closures last."""
    path = next((each for each in (picture.estimate, picture.truth, picture.odometry) if len(each)), _no_points())
    every = [
        Layer("landmarks of the map", picture.known, OTHER_COLOR, size=7.0, count=len(picture.known)),
        _strokes("loop closures", picture.closures, UNDECIDED_CLOSURE, 1.2),
        *_classes(picture),
        Layer("odometry", picture.odometry, ODOMETRY, width=1.6),
        _strokes("true loop closures", picture.true_closures, TRUE_CLOSURE, 1.6),
        Layer("estimate", picture.estimate, ESTIMATE, width=2.8),
        Layer("ground truth", picture.truth, TRUTH, width=1.2, is_dashed=True),
        Layer("start", path[:1], "#16a34a", size=13.0),
        Layer("end", path[-1:], "#dc2626", size=13.0, marker="s"),
        Layer("lost", picture.lost, "#b91c1c", size=13.0, marker="v", count=len(picture.lost)),
        Layer("found", picture.found, "#15803d", size=13.0, marker="^", count=len(picture.found)),
        _strokes("false loop closures", picture.false_closures, FALSE_CLOSURE, 4.0),
    ]
    return [layer for layer in every if len(layer.positions)]


def _strokes(name: str, ends: FloatArray, color: str, width: float) -> Layer:
    """A stroke between each pair of ends (C, 2, 3)."""
    strokes = np.concatenate([ends, np.full((len(ends), 1, 3), np.nan)], axis=1).reshape(-1, 3)
    return Layer(name, strokes, color, width=width, count=len(ends))


def _classes(picture: MapPicture) -> Iterator[Layer]:
    """The most frequent classes (ties by name), each with a colour and a marker of its own, then all others."""
    counts = sorted(Counter(picture.labels).items(), key=lambda item: (-item[1], item[0]))
    labels = np.array(picture.labels, dtype=np.str_)
    kept = [name for name, _ in counts[: len(CLASS_COLORS)]]
    for name, color, marker in zip(kept, CLASS_COLORS, CLASS_MARKERS, strict=False):
        rows = labels == name
        yield Layer(name, picture.landmarks[rows], color, size=7.0, marker=marker, count=int(rows.sum()))
    rest = ~np.isin(labels, kept)
    yield Layer(OTHER, picture.landmarks[rest], OTHER_COLOR, size=7.0, count=int(rest.sum()))
