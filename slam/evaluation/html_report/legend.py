"""The key of a chart as buttons, which wrap, can be reached by keyboard and take the colours of the theme."""

from __future__ import annotations

import math
from collections.abc import Sequence

from slam.evaluation.html_report.chart import Chart, Trace

_DASHES = {"dash": "6 4", "dot": "2 3", "dashdot": "6 3 2 3"}
_CROSS = ((-1, -3), (1, -3), (1, -1), (3, -1), (3, 1), (1, 1), (1, 3), (-1, 3), (-1, 1), (-3, 1), (-3, -1), (-1, -1))


def _corners(count: int, *, turn_deg: float = 0.0, inner: float = 1.0) -> list[tuple[float, float]]:
    """A regular polygon with a corner at the top, turned clockwise; every other corner ``inner`` of the radius."""
    angles = [2.0 * math.pi * k / count + math.radians(turn_deg) for k in range(count)]
    radii = [1.0 if k % 2 == 0 else inner for k in range(count)]
    return [(r * math.sin(a), -r * math.cos(a)) for a, r in zip(angles, radii, strict=True)]


_POLYGONS: dict[str, Sequence[tuple[float, float]]] = {
    "square": _corners(4, turn_deg=45.0),
    "diamond": _corners(4),
    "triangle-up": _corners(3),
    "triangle-right": _corners(3, turn_deg=90.0),
    "triangle-down": _corners(3, turn_deg=180.0),
    "triangle-left": _corners(3, turn_deg=270.0),
    "pentagon": _corners(5),
    "hexagon": _corners(6),
    "star": _corners(10, inner=0.45),
    "cross": [(x / 3.2, y / 3.2) for x, y in _CROSS],
    "x": [((x - y) / 4.2, (x + y) / 4.2) for x, y in _CROSS],
}


def render_legend(chart: Chart) -> str:
    """A button for each entry; it names the traces that it shows and hides."""
    entries = []
    for index, trace in enumerate(chart.traces):
        if trace.get("showlegend", True):
            group = trace.get("legendgroup")
            members = [k for k, other in enumerate(chart.traces) if k == index or (group and group == _group(other))]
            entries.append(
                f'<button type="button" aria-pressed="true" data-traces="{" ".join(map(str, members))}">'
                f"{_draw_sample(trace)}{trace['name']}</button>"
            )
    return f'<div class="legend" role="group" aria-label="Key">{"".join(entries)}</div>\n'


def _group(trace: Trace) -> str | None:
    group = trace.get("legendgroup")
    return group if isinstance(group, str) else None


def _draw_sample(trace: Trace) -> str:
    if trace["mode"] == "markers":
        return f'<svg viewBox="-8 -8 16 16" width="15" height="15" aria-hidden="true">{_draw_marker(trace)}</svg>'
    line = trace["line"]
    pattern = _DASHES.get(line.get("dash", "solid"), "")
    dash = f' stroke-dasharray="{pattern}"' if pattern else ""
    stroke = f'style="stroke:{_css(line["color"])}" stroke-width="{line["width"] + 0.5:g}"{dash}'
    return f'<svg viewBox="0 0 26 14" width="26" height="14" aria-hidden="true"><path d="M0 7H26" {stroke}/></svg>'


def _draw_marker(trace: Trace) -> str:
    marker = trace["marker"]
    style = f"fill:{_css(marker['color'])}"
    edge = marker.get("line", {})
    if edge.get("width", 0.0) > 1.0:
        style += f";stroke:{_css(edge['color'])};stroke-width:{edge['width']:g}"
    symbol = marker.get("symbol", "circle")
    if not isinstance(symbol, str) or symbol not in _POLYGONS:
        return f'<circle r="5" style="{style}"/>'
    points = " ".join(f"{6.5 * x:.2f},{6.5 * y:.2f}" for x, y in _POLYGONS[symbol])
    return f'<polygon points="{points}" style="{style}"/>'


def _css(color: str) -> str:
    """A property of the theme, or the colour itself."""
    return f"var({color})" if color.startswith("--") else color
