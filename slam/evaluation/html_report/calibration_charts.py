"""Whether the covariances promise what the errors keep."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtr

from slam.evaluation.html_report.chart import Chart, Trace, axis, plain_numbers
from slam.evaluation.html_report.markup import format_number
from slam.evaluation.metrics.calibration import CalibrationQuality, Consistency

PROBABILITIES = np.linspace(0.0, 1.0, 51)


def draw_calibration(quality: CalibrationQuality | None) -> Chart | None:
    """Share of the errors within the region of every probability; None where there is no error to compare."""
    if quality is None:
        return None
    parts = (
        (quality.pose, "poses", "--estimate", "solid"),
        (quality.planar_pose, "poses in the plane", "--estimate", "dash"),
        (quality.landmark, "landmarks", "--landmarks", "solid"),
        (quality.planar_landmark, "landmarks in the plane", "--landmarks", "dash"),
        (quality.closure, "closures", "--closure-true", "solid"),
        (quality.planar_closure, "closures in the plane", "--closure-true", "dash"),
    )
    traces = [_draw_part(part, name, color, dash) for part, name, color, dash in parts if part is not None]
    if not traces:
        return None
    layout = {
        "xaxis": axis("probability of the region", range=[0.0, 1.02], tickformat=".0%"),
        "yaxis": axis("errors within it", range=[0.0, 1.04], tickformat=".0%"),
    }
    summary = "Share of the errors within the region of every probability: " + ", ".join(t["name"] for t in traces)
    return Chart("calibration", summary, [_draw_ideal(), *traces], layout)


def _draw_ideal() -> Trace:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "right covariances",
        "x": [0.0, 1.0],
        "y": [0.0, 1.0],
        "line": {"color": "--muted", "width": 1.2, "dash": "dot"},
        "hoverinfo": "skip",
    }


def _draw_part(part: Consistency, name: str, color: str, dash: str) -> Trace:
    within = chdtr(part.dimension, part.squares)
    shares = np.searchsorted(np.sort(within), PROBABILITIES, side="right") / part.count
    return {
        "type": "scatter",
        "mode": "lines",
        "name": f"{name} (NEES {format_number(part.nees, 3)})",
        "x": plain_numbers(PROBABILITIES, 3),
        "y": plain_numbers(shares, 4),
        "line": {"color": color, "width": 2.0, "dash": dash},
        "hovertemplate": f"%{{y:.1%}} of {part.count}<br>within the region of %{{x:.0%}}<extra>{name}</extra>",
    }
