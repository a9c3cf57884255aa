"""Charts as the plain dictionaries that plotly.js draws."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

MOST_POINTS = 2500
"""A line or a cloud of points is thinned to so many: more than a screen has pixels, and a page stays small."""

Trace = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Chart:
    """Traces and layout of one chart; a colour that begins with ``--`` is a property of the page's theme.

    ``summary`` says what it shows to those who cannot see it.
    """

    name: str
    summary: str
    traces: list[Trace]
    layout: dict[str, Any] = field(default_factory=dict)
    shape: Literal["map", "plot"] = "plot"


def plain_numbers(values: NDArray[Any] | Iterable[float], decimals: int) -> list[float | None]:
    """Rounded numbers; None where one is not finite."""
    rounded = np.round(np.asarray(values, dtype=np.float64), decimals)
    return [value if finite else None for value, finite in zip(rounded.tolist(), np.isfinite(rounded), strict=True)]


def thin_rows(count: int, most: int = MOST_POINTS) -> NDArray[np.int64]:
    """At most ``most`` of ``count`` rows, evenly spread, the first and the last among them."""
    if count <= most:
        return np.arange(count, dtype=np.int64)
    return np.round(np.linspace(0, count - 1, most)).astype(np.int64)


def axis(title: str, **more: Any) -> dict[str, Any]:
    """An axis with its title, unit included."""
    return {"title": {"text": title}, **more}


def map_layout(points: NDArray[np.float64]) -> dict[str, Any]:
    """A view from above on points (N, 3), metres: equal scales, x to the right, y up."""
    points = points[np.isfinite(points).all(axis=1), :2]
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.zeros(2))
    margin = max(0.04 * float(np.max(high - low)), 1.0)
    x, y = (plain_numbers(span, 1) for span in zip(low - margin, high + margin, strict=True))
    return {
        "xaxis": axis("x [m]", range=x),
        "yaxis": axis("y [m]", range=y, scaleanchor="x", scaleratio=1),
        "dragmode": "pan",
    }
