"""The colours and marks of pictures of a map, the same in all of them, and which classes get one of their own."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from logs.scene import class_color

ESTIMATE, ODOMETRY, TRUTH = "#0b5cad", "#d97706", "#111827"
START, END = "#16a34a", "#dc2626"
CLOSURE, TRUE_CLOSURE, FALSE_CLOSURE, MISSED = "#d6249f", "#14b8a6", "#ff0000", "#7c3aed"
"""A closure without a truth, a true one, a false one; a revisit without a closure."""
LOST, FOUND = "#b91c1c", "#15803d"
OTHER_COLOR = "#9ca3af"
LEGEND_CLASSES = 12
OTHER = "other"


def class_hex(label: str) -> str:
    """The colour of a class, ``#rrggbb``: the one that it has in the viewers, too."""
    return "#" + "".join(f"{round(255.0 * part):02x}" for part in class_color(label)[:3])


def group_classes(labels: tuple[str, ...], most: int = LEGEND_CLASSES) -> list[tuple[str, NDArray[np.int64]]]:
    """Rows of each of the ``most`` most frequent classes (ties by name), then those of all others as "other"."""
    counts = sorted(Counter(labels).items(), key=lambda item: (-item[1], item[0]))
    kept = [name for name, _ in counts[:most]]
    names = np.array(labels, dtype=np.str_)
    groups = [(name, np.flatnonzero(names == name)) for name in kept]
    rest = np.flatnonzero(~np.isin(names, kept))
    return [*groups, (OTHER, rest)] if len(rest) else groups


def lift_pen(positions: NDArray[np.float64], jumps: NDArray[np.int64]) -> NDArray[np.float64]:
    """A path (N, 3) with a row of NaN after each row of ``jumps`` (J,), so that no line is drawn there."""
    return np.insert(positions, jumps + 1, np.nan, axis=0)
