"""An evaluation in six lines."""

from __future__ import annotations

from slam.evaluation.metrics.association import AssociationQuality
from slam.evaluation.metrics.calibration import CalibrationQuality
from slam.evaluation.metrics.landmarks import LandmarkQuality
from slam.evaluation.metrics.relocalization import RelocalizationQuality
from slam.evaluation.metrics.trajectory import TrajectoryErrors
from slam.evaluation.place_recognition.closures import ClosureQuality
from slam.evaluation.place_recognition.discoveries import Discoveries
from slam.evaluation.report.text_tables import fraction, number
from slam.evaluation.result import Evaluation


def summarize(evaluation: Evaluation) -> dict[str, str]:
    """Trajectory, landmarks, associations, closures, relocalization and covariances, a line each."""
    why = evaluation.unavailable
    return {
        "trajectory": _trajectory(evaluation) or _missing(why.get("trajectory")),
        "landmarks": _landmarks(evaluation.landmarks) or _missing(why.get("landmarks")),
        "associations": _associations(evaluation.associations) or _missing(why.get("associations")),
        "closures": _closures(evaluation.closures, why.get("closures")),
        "relocalization": _relocalization(evaluation.relocalization, why.get("relocalization")),
        "covariances": _covariances(evaluation.calibration) or _missing(why.get("calibration")),
    }


def _missing(reason: str | None) -> str:
    return f"not measured: {reason}" if reason else "not measured"


def _trajectory(evaluation: Evaluation) -> str:
    columns = {"": evaluation.estimate, "odometry ": evaluation.odometry, "online ": evaluation.online}
    known = {name: errors for name, errors in columns.items() if errors is not None}
    if not known:
        return ""
    first: TrajectoryErrors = next(iter(known.values()))
    errors_m = ", ".join(f"{name}{errors.absolute.rmse_m:.3f} m" for name, errors in known.items())
    second = evaluation.by_closure_reference
    by_second = f" ({second.absolute.rmse_m:.3f} m by the closure reference)" if second else ""
    return f"ATE {errors_m}{by_second}; {first.pose_count} poses over {first.length_m:.0f} m"


def _landmarks(quality: LandmarkQuality | None) -> str:
    if quality is None:
        return ""
    statistics = quality.windowed or quality.global_frame
    error = f", median error {statistics.median_m:.3f} m" if statistics else ""
    return (
        f"{quality.confirmed_count} confirmed{error}, class right {_percent(quality.class_accuracy)}, "
        f"precision {_percent(quality.precision)}, recall {_percent(quality.recall)}"
    )


def _associations(quality: AssociationQuality | None) -> str:
    if quality is None:
        return ""
    right = fraction(quality.precision, quality.right_count, quality.assigned_count)
    return f"precision {right}, recall {_percent(quality.recall)}"


def _closures(quality: ClosureQuality | None, reason: str | None) -> str:
    if quality is None:
        return _missing(reason)
    counted = f"{quality.accepted_count} of {quality.candidate_count} candidates accepted"
    if quality.true_count is None or quality.false_count is None:
        return f"{counted}; precision {_missing(reason)}"
    precision = fraction(quality.precision, quality.true_count, quality.true_count + quality.false_count)
    origin = _origin(quality.discoveries)
    revisits = quality.revisits
    if revisits is None or not revisits.revisit_count:
        return f"{counted}, precision {precision}; {origin}; no revisit"
    recall = fraction(revisits.recalled_count / revisits.revisit_count, revisits.recalled_count, revisits.revisit_count)
    if revisits.associated_count and revisits.recognised is not None:
        recall += f" ({100.0 * revisits.recognised:.2f} % with data association)"
    return f"precision {precision}, recall {recall}; {origin}"


def _origin(discoveries: Discoveries) -> str:
    text = f"{discoveries.found} retrieved, {discoveries.followed} propagated, {discoveries.led_back} back"
    share = discoveries.largest_false_share
    if share is None:
        return text
    return f"{text}; {discoveries.independent} independent: at most {100.0 * share:.0f} % false"


def _relocalization(quality: RelocalizationQuality | None, reason: str | None) -> str:
    if quality is None:
        return _missing(reason)
    if not quality.loss_count:
        return "never lost"
    lost = f"lost {quality.loss_count}, found {quality.fix_count}"
    judged = f", right {quality.right_count}, wrong {quality.wrong_count}" if quality.fix_count else ""
    travel = quality.median_distance_m
    return lost + judged + (f"; median travel to a fix {travel:.1f} m" if travel is not None else "")


def _covariances(quality: CalibrationQuality | None) -> str:
    if quality is None:
        return ""
    parts = {"keyframes": quality.pose, "landmarks": quality.landmark, "closures": quality.closure}
    values = ", ".join(f"{name} {number(part.nees)}" for name, part in parts.items() if part is not None)
    return f"NEES {values} (1 is right, more is overconfident)" if values else ""


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100.0 * share:.2f} %"
