"""The figures that people read, as sentences around the values of an evaluation's JSON.

A clause like ``"recall {closures[recall]:.2%}"`` names its figures; where one of these is undefined the clause is left
out.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

SUMMARY = {
    "trajectory": (
        "ATE {trajectory[ate_m]:.3f} m",
        ", odometry {trajectory[odometry_ate_m]:.3f} m",
        ", online {trajectory[online_ate_m]:.3f} m",
        "; {trajectory[estimate][pose_count]:d} poses over {trajectory[estimate][length_m]:.0f} m",
        "; axes of the true body turned by {trajectory[true_axes]:s}",
        "; the truth has positions only, of a point {trajectory[true_point_ahead_m]:.2f} m ahead",
        " and {trajectory[true_point_left_m]:.2f} m left of the body",
    ),
    "landmarks": (
        "{landmarks[confirmed_count]:d} confirmed",
        ", median error {landmarks[median_error_m]:.3f} m",
        ", class right {landmarks[class_accuracy]:.2%}",
        ", precision {landmarks[precision]:.2%}",
        ", recall {landmarks[recall]:.2%}",
    ),
    "associations": (
        "precision {associations[precision]:.2%} ({associations[right_count]:d} of {associations[assigned_count]:d})",
        ", recall {associations[recall]:.2%}",
    ),
    "closures": (
        "{closures[accepted_count]:d} of {closures[candidate_count]:d} candidates accepted",
        ", precision {closures[precision]:.2%} ({closures[true_count]:d} true, {closures[false_count]:d} false)",
        ", recall {closures[recall]:.2%} of {closures[revisit_count]:d} revisits",
        "; {closures[found_count]:d} retrieved, {closures[followed_count]:d} propagated",
        ", {closures[led_back_count]:d} back",
        ", {closures[proposer_counts][descriptor]:d} proposed by the descriptor",
        "; {closures[independent_count]:d} independent: at most {closures[largest_false_share]:.0%} false",
    ),
    "relocalization": (
        "a fix after {relocalization[fix_count]:d} of {relocalization[loss_count]:d} losses or starts in a map",
        ", right {relocalization[right_count]:d}, wrong {relocalization[wrong_count]:d}",
        "; median travel to a fix {relocalization[median_distance_m]:.1f} m",
    ),
    "calibration": (
        "NEES keyframes {calibration[pose_nees]:.3f}",
        ", landmarks {calibration[landmark_nees]:.3f}",
        ", closures {calibration[closure_nees]:.3f}",
        " (1 is right, more is overconfident)",
    ),
}
"""The six lines of ``dslam evaluate``, by the part of the JSON that they are about."""


def value_at(results: Mapping[str, Any], key: str) -> Any:
    """The value at a dotted key of an evaluation's JSON; None where it is undefined or not there."""
    value: Any = results
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def fill(results: Mapping[str, Any], *clauses: str) -> str:
    """The clauses of which all figures are defined; "" where none is defined."""
    filled = []
    for clause in clauses:
        with suppress(KeyError, TypeError):  # a figure that is not there, or that is None
            filled.append(clause.format_map(results).replace("%", " %"))
    is_any_defined = len(filled) > sum("{" not in clause for clause in clauses)
    return "".join(filled).lstrip(",; ") if is_any_defined else ""


def summarize(results: Mapping[str, Any]) -> dict[str, str]:
    """Trajectory, landmarks, associations, closures, relocalization and covariances, a line each."""
    lines = {}
    for part, clauses in SUMMARY.items():
        text, reason = fill(results, *clauses), results["unavailable"].get(part)
        is_never_lost = part == "relocalization" and results[part].get("loss_count") == 0
        missing = f"not measured: {reason}" if reason else "" if text else "not measured"
        lines[part] = "never lost" if is_never_lost else "; ".join(filter(None, (text, missing)))
    return lines
