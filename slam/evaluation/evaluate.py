"""From the records of a log to an evaluation: figures for JSON, and data for pictures."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from logs.container.json_text import plain
from logs.records import frozen
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import make_transform, roll_pitch_yaw_deg
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import NO_TRUTH, EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, synchronize
from slam.evaluation.metrics.alignment import align_path, find_axes, find_point
from slam.evaluation.metrics.association import evaluate_associations, label_detections
from slam.evaluation.metrics.calibration import evaluate_calibration
from slam.evaluation.metrics.landmarks import evaluate_landmarks, match_by_detections
from slam.evaluation.metrics.relocalization import evaluate_relocalization
from slam.evaluation.metrics.trajectory import TrajectoryErrors, evaluate_trajectory
from slam.evaluation.place_recognition.closures import describe_closures, judge_closures
from slam.evaluation.place_recognition.revisits import describe_revisits, find_revisits

NO_ESTIMATE = {
    "estimate": "no final trajectory (/slam/trajectory_stamped): the run was not finished",
    "odometry": "no odometry in the log, or several topics of it: choose one with --topic odometry=/topic",
    "online": "no /slam/pose in the log",
}
NO_ORIENTATIONS = "the truth has positions only; closures are judged with the orientations of the estimate"

_Measured = TypeVar("_Measured")


@frozen
class Evaluation:
    """The evaluation of one output log; a part that could not be measured is empty, its reason is in ``unavailable``.

    ``results``: all figures, as :meth:`to_json_dict` returns them. ``estimate`` is the final trajectory, ``odometry``
    the input alone, ``online`` the poses as they were at their time; None where they could not be measured.
    ``closures``: the candidates, as :func:`slam.evaluation.place_recognition.closures.judge_closures` returns them.
    """

    results: Mapping[str, Any]
    estimate: TrajectoryErrors | None = None
    odometry: TrajectoryErrors | None = None
    online: TrajectoryErrors | None = None
    closures: pd.DataFrame | None = None

    @property
    def unavailable(self) -> Mapping[str, str]:
        """Why a part could not be measured, by its name."""
        return self.results["unavailable"]

    def to_json_dict(self) -> dict[str, Any]:
        """Plain dicts, lists, strings and finite numbers; what is undefined, such as a precision of none, is None."""
        return dict(self.results)


def evaluate(records: EvaluationRecords, *, map_alignment: FloatArray | None = None) -> Evaluation:
    """Measure all that the records allow, by lengths in proportion to the sensor range of the run.

    A part that raises :class:`EvaluationError` is unavailable for this reason.

    Args:
        records: of the log.
        map_alignment: ``T_world_map`` (4, 4) of the map in which the robot was to be relocalized, by which its fixes
            there are judged.

    Raises:
        EvaluationError: a pose is not finite.
    """
    range_m, unavailable = records.sensor_range_m, dict[str, str]()
    protocol = Protocol() if range_m is None else Protocol().for_range(range_m)

    def measure(part: str, compute: Callable[..., _Measured], *args: object) -> _Measured | None:
        try:
            return compute(records, *args)
        except EvaluationError as error:
            unavailable[part] = str(error)
            return None

    paths = {"estimate": records.final_path, "odometry": records.odometry_path, "online": records.online_path}
    axes = _true_axes(records, protocol)
    true_path, point_m = _true_body(records) if axes is None else (records.true_path.turned(axes.T), (None, None))
    records = replace(records, true_path=true_path)
    trajectories = {
        name: measure("trajectory" if name == "estimate" else name, _trajectory, protocol, name, path)
        for name, path in paths.items()
    }
    if axes is None:
        trajectories = {
            name: errors and replace(errors, rpe_rotation_deg_per_100m=None) for name, errors in trajectories.items()
        }
    best = trajectories["estimate"] or trajectories["online"]
    T_world_map = best.T_world_map if best else None
    labelled = measure("associations", label_detections)
    matches = match_by_detections(records, labelled)
    landmarks = measure("landmarks", evaluate_landmarks, protocol, labelled, matches, T_world_map)
    judged = judge_closures(records, protocol)
    queries = measure("closures", find_revisits, judged, protocol)
    calibration, missing = ({}, NO_ORIENTATIONS) if axes is None else evaluate_calibration(records, matches, judged)
    if missing:
        unavailable["calibration"] = missing if records.true_path else NO_TRUTH
    if map_alignment is not None and not records.has_prior_map:
        unavailable["map_alignment"] = "not used: in this log the robot made its own map and was given none"
    relocalization = measure("relocalization", evaluate_relocalization, protocol, map_alignment, T_world_map)
    if relocalization and relocalization["undecided_count"]:
        reason = "no truth at their stamps" if records.true_path else NO_TRUTH
        unavailable["relocalization"] = "{undecided_count} of {fix_count} fixes: ".format_map(relocalization) + reason
    results = {
        "trajectory": _describe_trajectories(trajectories)
        | {"true_axes": _describe_turn(axes), "true_point_ahead_m": point_m[0], "true_point_left_m": point_m[1]},
        "associations": {} if labelled is None else evaluate_associations(labelled, revisit_m=protocol.revisit_m),
        "landmarks": landmarks or {},
        "closures": {} if judged is None else describe_closures(judged, protocol),
        "relocalization": relocalization or {},
        "calibration": calibration,
        "counters": records.statuses[-1].counters if records.statuses else {},
        "unavailable": unavailable,
        "protocol": plain(protocol),
    }
    if judged is not None and queries is not None:
        results["closures"] |= describe_revisits(queries, judged)
    return Evaluation(plain(results), **trajectories, closures=judged)


def _true_axes(records: EvaluationRecords, protocol: Protocol) -> FloatArray | None:
    """The axes (3, 3) of the body of the truth, in those of the estimate; None where the truth has positions only: its
    orientations are all the same although the body turns by more than a closure may be off.
    """
    with suppress(EvaluationError):
        R_est, R_gt = (poses.T_world_body[:, :3, :3] for poses in _aligned(records))
        turned = np.einsum("ij,nij->n", R_est[0], R_est)  # 1 + 2 cos of the angle from the first orientation
        if np.ptp(R_gt, axis=0).max() < 1e-9 and turned.min() < 1.0 + 2.0 * np.cos(
            np.deg2rad(protocol.closure_rotation_deg)
        ):
            return None
        return find_axes(R_est, R_gt)
    return np.eye(3)


def _true_body(records: EvaluationRecords) -> tuple[PoseSeries, FloatArray]:
    """The true poses by the positions of a point of the body, with the orientations of the estimate, and that point
    (3,) m.
    """
    estimate, truth = _aligned(records)
    point_m = find_point(estimate.T_world_body, truth.positions)
    R = estimate.T_world_body[:, :3, :3]
    return PoseSeries(truth.stamps_ns, make_transform(R, truth.positions - R @ point_m)), point_m


def _aligned(records: EvaluationRecords) -> tuple[PoseSeries, PoseSeries]:
    """The estimate in the world, and the truth at the same stamps.

    Raises:
        EvaluationError: they cannot be compared.
    """
    path = records.final_path or records.online_path
    est, gt = synchronize(path, records.true_path)
    T_world_map = align_path(est.positions, gt.positions)
    return PoseSeries(est.stamps_ns, T_world_map @ est.T_world_body), gt


def _describe_trajectories(trajectories: Mapping[str, TrajectoryErrors | None]) -> dict[str, Any]:
    """The main figures of each trajectory after its name (none for the estimate), and all figures by its name."""
    head = {
        f"{'' if name == 'estimate' else f'{name}_'}{figure}": getattr(errors, figure, None)
        for name, errors in trajectories.items()
        for figure in ("ate_m", "rpe_translation_percent", "rpe_rotation_deg_per_100m")
    }
    return {**head, **trajectories}


def _describe_turn(R: FloatArray | None) -> str | None:
    """None for no rotation, or an unknown one."""
    if R is None or np.array_equal(R, np.eye(3)):
        return None
    return "roll {:.0f}, pitch {:.0f}, yaw {:.0f} deg".format(*roll_pitch_yaw_deg(R))


def _trajectory(records: EvaluationRecords, protocol: Protocol, name: str, path: PoseSeries) -> TrajectoryErrors:
    if not path:
        raise EvaluationError(NO_ESTIMATE[name])
    if not records.true_path:
        raise EvaluationError(NO_TRUTH)
    return evaluate_trajectory(path, records.true_path, kidnapping_m=protocol.revisit_m)
