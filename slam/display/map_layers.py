"""Lines and marks of a picture of a map, with names and colours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from logs.records import frozen
from logs.scene import CLASS_COLORS
from slam.common.arrays import FloatArray

CLASS_MARKERS = "os^DvPXhp*<>"
"""As matplotlib names them."""
OTHER, OTHER_COLOR = "other", "#9ca3af"


@frozen
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


@frozen
class MapPicture:
    """Layers in one frame, in the order of drawing; those without positions are not drawn."""

    title: str
    subtitle: str
    layers: Sequence[Layer]


def strokes(name: str, ends: FloatArray, color: str, width: float) -> Layer:
    """A stroke between each pair of ends (C, 2, 3)."""
    lines = np.concatenate([ends, np.full((len(ends), 1, 3), np.nan)], axis=1).reshape(-1, 3)
    return Layer(name, lines, color, width=width, count=len(ends))


def class_layers(landmarks: FloatArray, labels: Sequence[str]) -> Iterator[Layer]:
    """Landmarks (L, 3) m: the most frequent classes, ties by name, with colours and markers, then all others."""
    counts = sorted(Counter(labels).items(), key=lambda item: (-item[1], item[0]))
    names = np.array(labels, dtype=np.str_)
    kept = [name for name, _ in counts[: len(CLASS_COLORS)]]
    for name, color, marker in zip(kept, CLASS_COLORS, CLASS_MARKERS, strict=False):
        rows = names == name
        yield Layer(name, landmarks[rows], color, size=7.0, marker=marker, count=int(rows.sum()))
    rest = ~np.isin(names, kept)
    yield Layer(OTHER, landmarks[rest], OTHER_COLOR, size=7.0, count=int(rest.sum()))


def count_classes(labels: Sequence[str]) -> str:
    """The numbers of landmarks and classes, for the subtitle."""
    return f"landmarks {len(labels)}, classes {len(set(labels))}"
