"""The colours of pictures of a map, the same in all of them, and which classes get one of their own."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from slam.common.arrays import IntArray

ESTIMATE, ODOMETRY, TRUTH = "#0b5cad", "#d97706", "#111827"
START, END = "#16a34a", "#dc2626"
CLOSURE, TRUE_CLOSURE, FALSE_CLOSURE, MISSED = "#d6249f", "#14b8a6", "#ff0000", "#7c3aed"
"""A closure without a truth, a true one, a false one; a revisit without a closure."""
LOST, FOUND = "#b91c1c", "#15803d"
OTHER_COLOR = "#9ca3af"
CLASS_COLORS = (
    *("#2f8f2f", "#9467bd", "#8c564b", "#e377c2", "#9a9b1c", "#00a6fb"),
    *("#4d4d4d", "#c51b7d", "#7bc043", "#4b2e83", "#f2c14e", "#8ecae6"),
)
"""Of the most frequent classes of a picture, in their order; none is that of a path."""
OTHER = "other"


@dataclass(frozen=True, slots=True, eq=False)
class ClassGroup:
    """The landmarks of one class in a picture: their rows (N,), and the colour; ``index`` -1 for all other classes."""

    name: str
    rows: IntArray
    color: str
    index: int


def group_classes(labels: tuple[str, ...]) -> list[ClassGroup]:
    """The most frequent classes (ties by name), each with a colour of its own, then all others as "other"."""
    counts = sorted(Counter(labels).items(), key=lambda item: (-item[1], item[0]))
    kept = [name for name, _ in counts[: len(CLASS_COLORS)]]
    names = np.array(labels, dtype=np.str_)
    groups = [
        ClassGroup(name, np.flatnonzero(names == name), CLASS_COLORS[index], index) for index, name in enumerate(kept)
    ]
    rest = np.flatnonzero(~np.isin(names, kept))
    return [*groups, ClassGroup(OTHER, rest, OTHER_COLOR, -1)] if len(rest) else groups
