"""A drive in the frame of its map: estimate, odometry, truth, landmarks and closures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.messages import FactorGraphRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, interpolate, invert
from slam.display.map_layers import MapPicture
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.landmarks import confirmed_rows
from slam.evaluation.result import Evaluation


def compose_picture(records: EvaluationRecords, evaluation: Evaluation, *, title: str = "Object map") -> MapPicture:
    """Bring the odometry into the map frame by its first pose, the truth by the alignment of the estimate.

    A closure joins the estimated positions of its two keyframes. Without a final trajectory the online poses are drawn.
    Truth that could not be aligned is left out. Paths are broken, by a row of NaN, at discontinuities of the odometry.
    The robot is marked as lost where it lost its place: before the discontinuity, not at its start in a given map.
    """
    # Where a run did not finish, its poses as they were at their time.
    estimate = records.final_path if records.trajectory else records.online_path
    errors = evaluation.estimate or evaluation.online
    odometry, truth = records.odometry_path, records.true_path
    spans_ns = _discontinuities(records.graph)
    objects = records.object_map
    rows = (
        [row for row in confirmed_rows(objects).tolist() if np.isfinite(objects.positions[row]).all()]
        if objects
        else []
    )
    losses = evaluation.results["relocalization"].get("losses", ())
    noticed_ns = [loss["lost_ns"] for loss in losses if loss["lost_ns"] > records.statuses[0].stamp_ns]
    lost_ns = [max((first for first in spans_ns[:, 0].tolist() if first < at), default=at) for at in noticed_ns]
    found_ns = [loss["fix_ns"] for loss in losses if loss["fix_ns"] is not None]
    path = _broken(estimate.stamps_ns, estimate.positions, spans_ns)
    driven_m = float(np.nansum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    return MapPicture(
        estimate=path,
        odometry=_broken(odometry.stamps_ns, _in_map(odometry, estimate), spans_ns),
        truth=_broken(truth.stamps_ns, apply(invert(errors.alignment.T_world_map), truth.positions), spans_ns)
        if errors
        else np.zeros((0, 3)),
        lost=_known(positions_at(estimate, lost_ns)),
        found=_known(positions_at(estimate, found_ns)),
        landmarks=objects.positions[rows] if objects else np.zeros((0, 3)),
        labels=tuple(objects.labels[row] for row in rows) if objects else (),
        title=title,
        length_m=errors.length_m if errors else driven_m or None,
        ate_m=errors.ate_m if errors else None,
        odometry_ate_m=evaluation.odometry.ate_m if evaluation.odometry else None,
        **_closures(evaluation, estimate),
    )


def positions_at(path: PoseSeries, at_ns: IntArray | Sequence[int]) -> FloatArray:
    """Positions (M, 3), metres, at any times (M,); NaN where the path does not reach."""
    at_ns = np.asarray(at_ns, dtype=np.int64)
    positions = np.full((len(at_ns), 3), np.nan)
    if len(path):
        inside = (at_ns >= path.stamps_ns[0]) & (at_ns <= path.stamps_ns[-1])
        positions[inside] = interpolate(path.stamps_ns, path.T_world_body, at_ns[inside])[:, :3, 3]
    return positions


def _closures(evaluation: Evaluation, estimate: PoseSeries) -> dict[str, FloatArray]:
    """Ends of the accepted closures as :class:`MapPicture` takes them."""
    if evaluation.closures is None:
        return {}
    closures = evaluation.closures[evaluation.closures["accepted"]]
    ends = np.stack(
        [positions_at(estimate, closures[k].to_numpy()) for k in ("stamp_ns", "reference_stamp_ns")], axis=1
    )
    is_known = np.isfinite(ends).all(axis=(1, 2))
    true, decided = closures["true"].to_numpy(), closures["decided"].to_numpy()
    return {
        "true_closures": ends[is_known & true],
        "false_closures": ends[is_known & decided & ~true],
        "closures": ends[is_known & ~decided],
    }


def _known(positions: FloatArray) -> FloatArray:
    return positions[np.isfinite(positions).all(axis=1)]


def _in_map(odometry: PoseSeries, estimate: PoseSeries) -> FloatArray:
    if not len(odometry) or not len(estimate):
        return odometry.positions
    first = int(np.argmin(np.abs(odometry.stamps_ns - estimate.stamps_ns[0])))
    return apply(estimate.T_world_body[0] @ invert(odometry.T_world_body[first]), odometry.positions)


def _discontinuities(graph: FactorGraphRecord | None) -> IntArray:
    """Stamps (J, 2) of the keyframes before and after each discontinuity of the odometry."""
    if graph is None:
        return np.zeros((0, 2), dtype=np.int64)
    stamp_of = dict(zip(graph.keyframe_ids.tolist(), graph.keyframe_stamps_ns.tolist(), strict=True))
    edges = zip(graph.edge_keyframe_ids.tolist(), graph.edge_kinds, strict=True)
    ends = [(stamp_of[first], stamp_of[second]) for (first, second), kind in edges if kind == "discontinuity"]
    return np.array(sorted(ends), dtype=np.int64).reshape(-1, 2)


def _broken(stamps_ns: IntArray, positions: FloatArray, spans_ns: IntArray) -> FloatArray:
    """A path with a row of NaN in the longest step within each span (J, 2)."""
    steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    jumps = list[int]()
    for first_ns, last_ns in spans_ns:
        begin = max(int(np.searchsorted(stamps_ns, first_ns, side="right")) - 1, 0)
        within = steps_m[begin : np.searchsorted(stamps_ns, last_ns)]
        if len(within) and first_ns < last_ns:
            jumps.append(begin + int(np.argmax(within)))
    return np.insert(positions, np.unique(np.array(jumps, dtype=np.int64)) + 1, np.nan, axis=0)
