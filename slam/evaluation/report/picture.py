"""A drive in the frame of its map: estimate, odometry, truth, landmarks and closures."""

import numpy as np

from logs.messages import FactorGraphRecord
from slam.backend.edge_kind import EdgeKind
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import apply, invert, step_lengths
from slam.display.map_picture import MapPicture, count_classes
from slam.evaluation.evaluate import Evaluation
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, are_known
from slam.object_map.map_io import are_of_kind

ODOMETRY = "#d97706"
TRUE_CLOSURE, FALSE_CLOSURE, UNDECIDED_CLOSURE = "#14b8a6", "#ff0000", "#d6249f"


def compose_picture(records: EvaluationRecords, evaluation: Evaluation, title: str) -> MapPicture:
    """Bring the odometry into the map frame by its first pose, the truth by the alignment of the estimate.

    A closure joins the estimated positions of its two keyframes. Without a final trajectory the online poses are drawn.
    Truth that could not be aligned is left out, and of a given map what is far from the path. Paths are broken, by a
    row of NaN, at discontinuities of the odometry. The robot is marked as lost where it lost its place: before the
    discontinuity, not at its start in a given map.

    Args:
        records: of the drive, with an estimate.
        evaluation: of these records.
        title: of the picture.
    """
    # Where a run did not finish, its poses as they were at their time.
    estimate = records.final_path or records.online_path
    errors = evaluation.estimate or evaluation.online
    spans_ns = _discontinuities(records.graph)
    path = _broken(estimate, np.eye(4), spans_ns)
    odometry = _broken(records.odometry_path, _start_in_map(records.odometry_path, estimate), spans_ns)
    truth = np.zeros((0, 3)) if errors is None else _broken(records.true_path, invert(errors.T_world_map), spans_ns)
    objects, landmarks, labels = records.object_map, np.zeros((0, 3)), list[str]()
    if objects is not None:
        is_shown = objects.is_confirmed & np.isfinite(objects.positions).all(axis=1)
        if records.has_prior_map:
            is_shown &= _are_around(path, objects.positions)
        rows = np.flatnonzero(is_shown)
        landmarks, labels = objects.positions[rows], [objects.labels[row] for row in rows]
    lost, found = _losses(records, evaluation, estimate, spans_ns)
    true, false, undecided = _closures(evaluation, estimate)
    driven_m = float(np.nansum(step_lengths(path)))
    figures = {
        "path {:.0f} m": errors.length_m if errors else driven_m or None,
        count_classes(labels): len(labels) or None,
        "ATE {:.3f} m": errors.ate_m if errors else None,
        "odometry alone {:.3f} m": evaluation.odometry.ate_m if evaluation.odometry else None,
    }
    subtitle = "   ·   ".join(text.format(value) for text, value in figures.items() if value is not None)
    picture = MapPicture(title, subtitle)
    picture.add_strokes("loop closures", undecided, UNDECIDED_CLOSURE, 1.2)
    picture.add_landmarks(landmarks, labels)
    picture.add_line("odometry", odometry, ODOMETRY, 1.6)
    picture.add_strokes("true loop closures", true, TRUE_CLOSURE, 1.6)
    picture.add_line("estimate", path, "#0b5cad", 2.8)
    picture.add_line("ground truth", truth, "#6b7280", 1.2, style=(0, (6, 4)))
    picture.add_marks("start", path[:1], "#16a34a", "o", size=13.0)
    picture.add_marks("end", path[-1:], "#dc2626", "s", size=13.0)
    picture.add_marks("lost", lost, "#b91c1c", "v", size=13.0, count=len(lost))
    picture.add_marks("found", found, "#15803d", "^", size=13.0, count=len(found))
    picture.add_strokes("false loop closures", false, FALSE_CLOSURE, 4.0)
    return picture


def _are_around(path: FloatArray, positions: FloatArray) -> BoolArray:
    """Which positions (L, 3) are in a rectangle around a path (N, 3), half as far away as it is long."""
    low, high = np.nanmin(path[:, :2], axis=0), np.nanmax(path[:, :2], axis=0)
    margin_m = 0.5 * (high - low).max()
    plane = positions[:, :2]
    return ((plane >= low - margin_m) & (plane <= high + margin_m)).all(axis=1)


def _losses(
    records: EvaluationRecords, evaluation: Evaluation, estimate: PoseSeries, spans_ns: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Where the robot lost its place, and where it found it again: (J, 3) m."""
    losses = evaluation.results["relocalization"].get("losses", ())
    noticed_ns = [loss["lost_ns"] for loss in losses if loss["lost_ns"] > records.statuses[0].stamp_ns]
    lost_ns = [max((first for first in spans_ns[:, 0].tolist() if first < at), default=at) for at in noticed_ns]
    found_ns = [loss["fix_ns"] for loss in losses if loss["fix_ns"] is not None]
    lost, found = (estimate.poses_at(np.array(at_ns, np.int64)) for at_ns in (lost_ns, found_ns))
    return lost[are_known(lost), :3, 3], found[are_known(found), :3, 3]


def _closures(evaluation: Evaluation, estimate: PoseSeries) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ends (C, 2, 3) m of the accepted closures that are true, false and undecided."""
    closures = evaluation.closures
    if closures is None:
        return (np.zeros((0, 2, 3)),) * 3
    closures = closures[closures["accepted"]]
    stamps_ns = [closures[name].to_numpy() for name in ("stamp_ns", "reference_stamp_ns")]
    ends = np.stack([estimate.poses_at(at_ns)[:, :3, 3] for at_ns in stamps_ns], axis=1)
    is_known = np.isfinite(ends).all(axis=(1, 2))
    true, decided = closures["true"].to_numpy(), closures["decided"].to_numpy()
    return ends[is_known & true], ends[is_known & decided & ~true], ends[is_known & ~decided]


def _start_in_map(odometry: PoseSeries, estimate: PoseSeries) -> FloatArray:
    """``T_map_odom`` (4, 4) by the first pose of the estimate."""
    if not odometry:
        return np.eye(4)
    first = np.argmin(np.abs(odometry.stamps_ns - estimate.stamps_ns[0]))
    return estimate.T_world_body[0] @ invert(odometry.T_world_body[first])


def _discontinuities(graph: FactorGraphRecord | None) -> IntArray:
    """Stamps (J, 2) of the keyframes before and after each discontinuity of the odometry."""
    if graph is None:
        return np.zeros((0, 2), dtype=np.int64)
    stamp_of = dict(zip(graph.keyframe_ids.tolist(), graph.keyframe_stamps_ns.tolist(), strict=True))
    jumps = graph.edge_keyframe_ids[are_of_kind(graph, EdgeKind.DISCONTINUITY)].tolist()
    return np.array([[stamp_of[end] for end in ends] for ends in jumps], dtype=np.int64).reshape(-1, 2)


def _broken(path: PoseSeries, T_map_path: FloatArray, spans_ns: IntArray) -> FloatArray:
    """A path in the map with a row of NaN in the longest step within each span (J, 2)."""
    stamps_ns, steps_m, jumps = path.stamps_ns, step_lengths(path.positions), list[int]()
    for first_ns, last_ns in spans_ns:
        begin = max(np.searchsorted(stamps_ns, first_ns, side="right") - 1, 0)
        within = steps_m[begin : np.searchsorted(stamps_ns, last_ns)]
        if len(within) and first_ns < last_ns:
            jumps.append(begin + np.argmax(within))
    return np.insert(apply(T_map_path, path.positions), np.unique(np.array(jumps, dtype=np.int64)) + 1, np.nan, axis=0)
