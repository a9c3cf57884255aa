"""The figures that people read, as sentences around the values of an evaluation's JSON.

A clause like ``"recall {closures.recall:.2%}"`` names its figures by their dotted keys; where one of these is undefined
the clause is left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from slam.evaluation.metrics.statistics import UNDEFINED


@dataclass(frozen=True, slots=True)
class Figure:
    """A number of an evaluation by its dotted key, with a short heading; ``is_error``: the smaller, the better."""

    key: str
    heading: str
    digits: int
    is_error: bool = False

    def of(self, results: Mapping[str, Any]) -> float | None:
        """Its value in an evaluation's JSON; None where it is undefined or not there."""
        value = value_at(results, self.key)
        return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


HEADLINE_FIGURES = (
    Figure("trajectory.ate_m", "ATE m", 3, is_error=True),
    Figure("trajectory.rpe_translation_percent", "RPE %", 3, is_error=True),
    Figure("trajectory.rpe_rotation_deg_per_100m", "RPE deg/100 m", 4, is_error=True),
    Figure("closures.precision", "closures precision", 3),
    Figure("closures.recall", "closures recall", 3),
    Figure("closures.recall_opposite", "closures recall, opposite", 3),
    Figure("closures.average_precision", "average precision", 3),
    Figure("closures.f1_max", "largest F1", 3),
    Figure("closures.median_translation_error_m", "closures error m", 3, is_error=True),
    Figure("relocalization.success_rate", "relocalizations right", 3),
    Figure("associations.precision", "associations precision", 4),
    Figure("associations.recall", "associations recall", 4),
    Figure("landmarks.precision", "landmarks precision", 4),
    Figure("landmarks.recall", "landmarks recall", 4),
    Figure("landmarks.median_error_m", "landmarks error m", 3, is_error=True),
)
"""Those by which runs are compared."""

SUMMARY = {
    "trajectory": (
        "ATE {trajectory.ate_m:.3f} m",
        ", odometry {trajectory.odometry_ate_m:.3f} m",
        ", online {trajectory.online_ate_m:.3f} m",
        "; {trajectory.estimate.pose_count} poses over {trajectory.estimate.length_m:.0f} m",
    ),
    "landmarks": (
        "{landmarks.confirmed_count} confirmed",
        ", median error {landmarks.median_error_m:.3f} m",
        ", class right {landmarks.class_accuracy:.2%}",
        ", precision {landmarks.precision:.2%}",
        ", recall {landmarks.recall:.2%}",
    ),
    "associations": (
        "precision {associations.precision:.2%} ({associations.right_count} of {associations.assigned_count})",
        ", recall {associations.recall:.2%}",
    ),
    "closures": (
        "{closures.accepted_count} of {closures.candidate_count} candidates accepted",
        ", precision {closures.precision:.2%} ({closures.true_count} true, {closures.false_count} false)",
        ", recall {closures.recall:.2%} of {closures.revisit_count} revisits",
        " ({closures.recognised:.2%} with data association)",
        "; {closures.found_count} retrieved, {closures.followed_count} propagated, {closures.led_back_count} back",
        ", {closures.descriptor_verdict}",
        "; {closures.independent_count} independent: at most {closures.largest_false_share:.0%} false",
    ),
    "relocalization": (
        "a fix after {relocalization.fix_count} of {relocalization.loss_count} losses or starts in a map",
        ", right {relocalization.right_count}, wrong {relocalization.wrong_count}",
        "; median travel to a fix {relocalization.median_distance_m:.1f} m",
    ),
    "calibration": (
        "NEES keyframes {calibration.pose_nees:.3f}",
        ", landmarks {calibration.landmark_nees:.3f}",
        ", closures {calibration.closure_nees:.3f}",
        " (1 is right, more is overconfident)",
    ),
}
"""The six lines of ``dslam evaluate``, by the part of the JSON that they are about."""

_FIELD = re.compile(r"\{([\w.]+)(:[^}]*)?\}")


def value_at(results: Mapping[str, Any], key: str) -> Any:
    """The value at a dotted key of an evaluation's JSON; None where it is undefined or not there."""
    value: Any = results
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def leaves(results: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values by their dotted keys; lists, which are curves or tables of their own, are left out."""
    for name, value in results.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{prefix}{name}.")
        elif not isinstance(value, list):
            yield prefix + name, value


def fill(results: Mapping[str, Any], *clauses: str) -> str:
    """The clauses of which all figures are defined; "" where none is defined."""
    defined = [
        clause for clause in clauses if all(value_at(results, key) is not None for key, _ in _FIELD.findall(clause))
    ]
    if not any(_FIELD.search(clause) for clause in defined):
        return ""
    text = _FIELD.sub(lambda found: _format(value_at(results, found[1]), found[2] or ""), "".join(defined))
    return text.lstrip(",; ")


def summarize(results: Mapping[str, Any]) -> dict[str, str]:
    """Trajectory, landmarks, associations, closures, relocalization and covariances, a line each."""
    lines = {}
    for part, clauses in SUMMARY.items():
        text, reason = fill(results, *clauses), results["unavailable"].get(part)
        is_never_lost = part == "relocalization" and results[part]["loss_count"] == 0
        missing = f"not measured: {reason}" if reason else "" if text else "not measured"
        lines[part] = "never lost" if is_never_lost else "; ".join(each for each in (text, missing) if each)
    return lines


def format_number(value: float | None, digits: int = 4) -> str:
    """``value`` to so many significant digits; whole numbers keep all before the point."""
    if value is None or not math.isfinite(value):
        return UNDEFINED
    if value != 0.0 and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}g}"
    decimals = digits - 1 - (math.floor(math.log10(abs(value))) if value else 0)
    return f"{value:.{max(decimals, 0)}f}"


def _format(value: Any, spec: str) -> str:
    return format(value, spec.removeprefix(":")).replace("%", " %")
