"""Lines and points as the plain dictionaries that plotly draws."""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from logs.container.names import visible
from slam.common.arrays import FloatArray, IntArray

MAX_POINTS = 5000
"""A line, and all marks of a chart, are thinned to so many: a browser draws each mark as an object of its own."""
MAX_NAME_LENGTH = 80

Trace = dict[str, Any]
Chart = dict[str, Any]
"""``data``: traces, and ``layout``, of plotly."""


def make_chart(traces: list[Trace], x: dict[str, Any], y: dict[str, Any], **layout: Any) -> Chart | None:
    """A chart with its axes; None without traces."""
    return {"data": traces, "layout": {"xaxis": x, "yaxis": y, **layout}} if traces else None


def make_axis(title: str, **more: Any) -> dict[str, Any]:
    """An axis with its title, unit included."""
    return {"title": {"text": title}, **more}


def draw_line(x: FloatArray, y: FloatArray, name: str, color: str, width: float = 2.0, **more: Any) -> Trace:
    """A line through N points, thinned and broken at NaN; ``dash``: of the line."""
    rows = thin(np.isfinite(x))
    style = {"color": color, "width": width, "dash": more.pop("dash", "solid")}
    return _scatter("lines", x[rows], y[rows], name, line=style, hoverinfo="skip") | more


def draw_points(
    positions: FloatArray,
    name: str,
    texts: list[str],
    color: Any,
    symbol: Any = "circle",
    size: float = 7.0,
    **more: Any,
) -> Trace:
    """Points (N, 2 or 3) with a label each."""
    marker = {"color": color, "symbol": symbol, "size": size, "line": {"color": "white", "width": 0.7}}
    marker |= more.pop("marker", {})
    trace = _scatter("markers", positions[:, 0], positions[:, 1], name, marker=marker, text=texts)
    return trace | {"hovertemplate": "%{text}<extra></extra>"} | more


def thin(is_known: np.ndarray, share: float = 1.0) -> IntArray:
    """Rows (R,) of N, evenly spread, the first and the last among them, and all breaks of a line.

    At most :data:`MAX_POINTS` of them, or that ``share`` of so many.
    """
    count, most = len(is_known), max(int(share * MAX_POINTS), 1)
    evenly = np.round(np.linspace(0, count - 1, most)).astype(np.int64) if count > most else np.arange(count)
    breaks = np.flatnonzero(~is_known)
    around = np.concatenate([breaks - 1, breaks, breaks + 1])
    return np.union1d(evenly, around[(around >= 0) & (around < count)]).astype(np.int64)


def label(text: str) -> str:
    """A name from a log on one line, cut where it is too long, and letter by letter, not as plotly's markup."""
    shown = visible(text).replace("\n", " ")
    return html.escape(shown if len(shown) <= MAX_NAME_LENGTH else shown[: MAX_NAME_LENGTH - 1] + "…", quote=False)


def _scatter(mode: str, x: FloatArray, y: FloatArray, name: str, **more: Any) -> Trace:
    return {"type": "scatter", "mode": mode, "name": name, "x": np.round(x, 3), "y": np.round(y, 3), **more}
