"""The colours and marks of pictures of a map, the same in all of them, and which classes get one of their own."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

ESTIMATE, ODOMETRY, TRUTH = "#0b5cad", "#d97706", "#111827"
START, END = "#16a34a", "#dc2626"
CLOSURE, TRUE_CLOSURE, FALSE_CLOSURE, MISSED = "#d6249f", "#14b8a6", "#ff0000", "#7c3aed"
"""A closure without a truth, a true one, a false one; a revisit without a closure."""
CLASS_COLORS = (
    *("#2e9e5b", "#d64545", "#8456c4", "#8c6239", "#17a2b8", "#c9a50a"),
    *("#6b8e23", "#e377c2", "#4b5b8c", "#f4978e", "#00695c", "#b39ddb"),
)
"""None of the classes has the colour of a path."""
OTHER_COLOR = "#9ca3af"
LEGEND_CLASSES = len(CLASS_COLORS)
OTHER = "other"


def group_classes(labels: tuple[str, ...], most: int = LEGEND_CLASSES) -> list[tuple[str, NDArray[np.int64]]]:
    """Rows of each of the ``most`` most frequent classes (ties by name), then those of all others as "other"."""
    counts = sorted(Counter(labels).items(), key=lambda item: (-item[1], item[0]))
    kept = [name for name, _ in counts[:most]]
    names = np.array(labels, dtype=np.str_)
    groups = [(name, np.flatnonzero(names == name)) for name in kept]
    rest = np.flatnonzero(~np.isin(names, kept))
    return [*groups, (OTHER, rest)] if len(rest) else groups
