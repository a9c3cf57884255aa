"""Lines and points seen from above."""

from __future__ import annotations

from typing import Any

from slam.common.arrays import FloatArray, IntArray
from slam.evaluation.html_report.chart import Trace, plain_numbers
from slam.evaluation.inputs.synchronization import PoseSeries


def draw_line(positions: FloatArray, name: str, color: str, width: float, *, dash: str = "solid", **more: Any) -> Trace:
    """A line through positions (N, 3), metres, broken where one is not finite."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": plain_numbers(positions[:, 0], 2),
        "y": plain_numbers(positions[:, 1], 2),
        "line": {"color": color, "width": width, "dash": dash},
        **more,
    }


def draw_points(positions: FloatArray, name: str, texts: list[str], marker: dict[str, Any]) -> Trace:
    """Points with a label each; without any, an invisible one keeps the entry of the legend."""
    there = len(positions) > 0
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": plain_numbers(positions[:, 0], 2) if there else [None],
        "y": plain_numbers(positions[:, 1], 2) if there else [None],
        "text": texts if there else [""],
        "hovertemplate": "%{text}<extra></extra>",
        "marker": marker,
    }


def describe_moments(path: PoseSeries, at_ns: IntArray) -> list[str]:
    """Time and travel (M,) of a path at the times ``at_ns`` (M,)."""
    if len(path.stamps_ns) == 0:
        return [""] * len(at_ns)
    seconds = (at_ns - path.stamps_ns[0]) * 1e-9
    travelled_m = path.travelled_at_m(at_ns)
    return [f"{s:.1f} s, {m:.0f} m travelled" for s, m in zip(seconds, travelled_m, strict=True)]
