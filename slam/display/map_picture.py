"""One picture of a map from above: trajectories, landmarks by class, loop closures."""

import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from logs.container.names import visible
from logs.scene import CLASS_COLORS
from logs.storage.placement import replacing
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError

_INK, _MUTED, _GRID = "#1f2937", "#4b5563", "#e5e7eb"
CLASS_MARKERS = "os^DvPXhp*<>"
"""As matplotlib names them."""


class MapPicture:
    """A map from above: x to the right, y up, equal scales. What is drawn later is above what was drawn before.

    All of it is in the key by its name, with its ``count`` in brackets. The same calls give the same bytes.
    """

    def __init__(self, title: str, subtitle: str) -> None:
        self.figure = Figure(dpi=100.0, facecolor="white")
        self.figure.set_layout_engine("constrained", h_pad=0.15, w_pad=0.15)
        self._axes = axes = self.figure.add_subplot()
        axes.set_aspect("equal", adjustable="box", anchor="NW")
        axes.set_xlabel("x [m]", fontsize=13, color=_INK)
        axes.set_ylabel("y [m]", fontsize=13, color=_INK)
        axes.tick_params(labelsize=12, colors=_MUTED, length=0)
        axes.grid(visible=True, color=_GRID, linewidth=0.8)
        axes.set_axisbelow(True)
        axes.spines[:].set_visible(False)
        # A dollar sign in a name is one.
        axes.set_title(
            _cut(title, 60), loc="left", fontsize=20, fontweight="bold", color=_INK, pad=30, parse_math=False
        )
        axes.annotate(
            subtitle,
            (0.0, 1.0),
            xytext=(0.0, 6.0),
            xycoords="axes fraction",
            textcoords="offset points",
            fontsize=13,
            color=_MUTED,
        )

    def add_line(
        self, name: str, positions: FloatArray, color: str, width: float, *, style: Any = "-", count: int | None = None
    ) -> None:
        """Join positions (N, 3) m by a line that is broken at NaN; ``style``: of matplotlib."""
        if len(positions):
            self._axes.plot(
                *positions[:, :2].T, color=color, linewidth=width, linestyle=style, **self._entry(name, count)
            )

    def add_strokes(self, name: str, ends: FloatArray, color: str, width: float) -> None:
        """Join each pair of ends (C, 2, 3) m."""
        lines = np.concatenate([ends, np.full((len(ends), 1, 3), np.nan)], axis=1).reshape(-1, 3)
        self.add_line(name, lines, color, width, count=len(ends))

    def add_marks(
        self, name: str, positions: FloatArray, color: str, marker: str, *, size: float = 7.0, count: int | None = None
    ) -> None:
        """Mark positions (N, 3) m; ``marker``: as matplotlib names it; ``size``: diameter."""
        if len(positions):
            x, y = positions[:, :2].T
            self._axes.scatter(
                x,
                y,
                s=size**2,
                c=color,
                marker=marker,
                linewidths=0.07 * size,
                edgecolors="white",
                **self._entry(name, count),
            )

    def add_landmarks(self, positions: FloatArray, labels: Sequence[str]) -> None:
        """Mark landmarks (L, 3) m: the most frequent classes, ties by name, each by its colour, then all others."""
        counts = sorted(Counter(labels).items(), key=lambda item: (-item[1], item[0]))[: len(CLASS_COLORS)]
        names = np.array(labels, dtype=np.str_)
        for (name, count), color, marker in zip(counts, CLASS_COLORS, CLASS_MARKERS, strict=False):
            self.add_marks(name, positions[names == name], color, marker, count=count)
        rest = positions[~np.isin(names, [name for name, _ in counts])]
        self.add_marks("other", rest, "#9ca3af", "o", count=len(rest))

    def save(self, path_png: str | Path) -> None:
        """Write a PNG file, by way of ``NAME.part``.

        Raises:
            EvaluationError: there is nothing to draw.
            UnwritableLogError: the file cannot be written.
        """
        if not self._axes.has_data():
            raise EvaluationError("no position to draw")
        low, high = self._axes.dataLim.get_points()
        margin = max(0.03 * np.max(high - low), 1.0)
        low, high = low - margin, high + margin
        # A straight street must not become a strip: the short side is widened to half of the long one.
        missing = np.maximum(0.5 * np.max(high - low) - (high - low), 0.0)
        low, high = low - 0.5 * missing, high + 0.5 * missing
        self._axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        self.figure.set_size_inches(16.0, min(12.2 * (high - low)[1] / (high - low)[0] + 1.5, 16.0))
        key = self.figure.legend(loc="outside right upper", fontsize=13, frameon=False, labelcolor=_INK)
        for text in key.get_texts():
            text.set_parse_math(False)
        with replacing(path_png) as part, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of letters that are in no font
            self.figure.savefig(part, format="png", metadata={"Software": None})  # no version of matplotlib

    def _entry(self, name: str, count: int | None) -> dict[str, Any]:
        """Its entry in the key, and its place above the grid and what was drawn before."""
        label = _cut(name, 40) + ("" if count is None else f" ({count})")
        # The key leaves out what begins with an underscore.
        zorder = 1 + len(self._axes.lines) + len(self._axes.collections)
        return {"label": f" {label}" if label.startswith("_") else label, "zorder": zorder}


def count_classes(labels: Sequence[str]) -> str:
    """The numbers of landmarks and classes, for the subtitle."""
    return f"landmarks {len(labels)}, classes {len(set(labels))}"


def _cut(name: str, most: int) -> str:
    """As many letters of a name as have room."""
    text = visible(name).replace("\n", " ")
    return text if len(text) <= most else f"{text[: most - 1]}…"
