"""A drive there and back, and loop-closure candidates about it."""

from dataclasses import replace
from typing import Any

import numpy as np

from logs.messages import LoopClosureRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import invert, transform_from_xyz_yaw
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses
from tests.slam.evaluation.drives import START_NS
from tests.slam.evaluation.results import graph

SECOND = 1_000_000_000
THERE_AND_BACK_REVISITS = tuple(range(168, 241, 2))
"""Keyframes of :func:`there_and_back` near one at least 100 m before: 240 - k is within 5 m of an even j <= k - 100."""


def at_ns(index: int) -> int:
    return START_NS + index * SECOND


def series_of(T_world_body: FloatArray) -> PoseSeries:
    """One pose a second."""
    return clean_poses(np.array([at_ns(index) for index in range(len(T_world_body))], int), T_world_body)


def there_and_back() -> PoseSeries:
    """120 m along x and back, a metre a second: the pose ``index`` has travelled ``index`` metres."""
    index = np.arange(241)
    xyz = np.zeros((241, 3))
    xyz[:, 0] = np.where(index <= 120, index, 240 - index)
    return series_of(transform_from_xyz_yaw(xyz, np.where(index <= 120, 0.0, np.pi)))


def keyframes(indices: range | list[int]) -> tuple[IntArray, IntArray]:
    """Ids and stamps of keyframes at the poses of these indices, which are their ids."""
    ids = np.array(indices, int)
    return ids, np.array([at_ns(index) for index in indices], int)


def closure(
    query: int,
    reference: int,
    *,
    truth: PoseSeries | None = None,
    shift_m: float = 0.0,
    turn_rad: float = 0.0,
    stage: str = "accepted",
    reason: str = "",
    seed: int | None = None,
) -> LoopClosureRecord:
    """A candidate between the poses of two indices, off the truth by ``shift_m`` along its x and by ``turn_rad``.

    Without a truth it has no transform.
    """
    T_reference_query = None
    if truth is not None:
        T_error = transform_from_xyz_yaw(np.array([shift_m, 0.0, 0.0]), turn_rad)
        T_reference_query = invert(truth.T_world_body[reference]) @ truth.T_world_body[query] @ T_error
    return LoopClosureRecord(
        stamp_ns=at_ns(query),
        query_keyframe_id=query,
        reference_keyframe_id=reference,
        accepted=stage == "accepted",
        stage=stage,
        reason=reason,
        score=1.0,
        T_reference_query=T_reference_query,
        reference_stamp_ns=at_ns(reference),
        inserted=stage == "accepted",
        seed_query_keyframe_id=seed,
    )


def drive_with(
    records: list[LoopClosureRecord], truth: PoseSeries, ids: IntArray, stamps_ns: IntArray
) -> EvaluationRecords:
    """Candidates of a drive with keyframes at the poses of the truth."""
    return EvaluationRecords(
        true_path=truth,
        closures=tuple(records),
        graph=replace(graph(stamps_ns, np.tile(np.eye(4), (len(ids), 1, 1))), keyframe_ids=ids),
    )


def judge(
    records: list[LoopClosureRecord], truth: PoseSeries, indices: range | list[int] = range(0, 241, 2)
) -> dict[str, Any]:
    """Figures of closures by the keys of the JSON."""
    figures: dict[str, Any] = evaluate(drive_with(records, truth, *keyframes(indices))).to_json_dict()["closures"]
    return figures
