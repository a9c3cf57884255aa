"""Whole evaluations of logs that lack something or are odd: from the records to the JSON and the tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import GroundTruthPose, LoopClosureRecord, Odometry, SlamPose, StatusRecord, TrajectoryRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import interpolate, transform_from_xyz_yaw
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords
from tests.slam.evaluation.loops import THERE_AND_BACK_REVISITS, at_ns, closure, there_and_back
from tests.slam.evaluation.results import at_json, graph, printed

TRUTH = there_and_back()
REVISITS = THERE_AND_BACK_REVISITS
RIGHT = tuple(closure(query, 240 - query, truth=TRUTH, rank=1, score=float(query)) for query in REVISITS)


def drive(closures: Sequence[LoopClosureRecord] = (), *, truth: EvaluationRecords | None = None) -> EvaluationRecords:
    """120 m there and back, a keyframe every two metres; the estimate is the truth with an error of 0.1 m in height."""
    T_map_body = TRUTH.T_world_body.copy()
    T_map_body[::2, 2, 3] += 0.1
    stamps_ns = TRUTH.stamps_ns
    records = EvaluationRecords(
        trajectory=TrajectoryRecord(0, "map", stamps_ns, T_map_body),
        online_poses=tuple(SlamPose(int(t), T) for t, T in zip(stamps_ns, T_map_body, strict=True)),
        odometry=tuple(Odometry(int(t), T) for t, T in zip(stamps_ns, T_map_body, strict=True)),
        closures=tuple(closures),
        graph=replace(graph(stamps_ns[::2], T_map_body[::2]), keyframe_ids=np.arange(0, 241, 2)),
        statuses=(StatusRecord(at_ns(0), "MAPPING", "info", ""),),
        configuration={"loop_closure": {"max_candidates": 3}},
    )
    true = truth or EvaluationRecords(true_poses=poses_of(stamps_ns, TRUTH.T_world_body))
    return replace(records, true_poses=true.true_poses)


def poses_of(stamps_ns: IntArray, T_world_body: FloatArray) -> tuple[GroundTruthPose, ...]:
    return tuple(GroundTruthPose(int(stamp), T) for stamp, T in zip(stamps_ns, T_world_body, strict=True))


def test_ground_truth_of_another_rate_and_in_another_frame() -> None:
    records, plain = drive(RIGHT), evaluate(drive(RIGHT))
    T_other_world = transform_from_xyz_yaw(np.array([400.0, -300.0, 20.0]), 2.0)
    often_ns = np.sort(np.concatenate([TRUTH.stamps_ns, TRUTH.stamps_ns[:-1] + 370_000_000]))
    # Every 1.4 s, so that hardly a stamp is that of a keyframe.
    seldom_ns = np.arange(TRUTH.stamps_ns[0], TRUTH.stamps_ns[-1], 1_400_000_000)
    for stamps_ns in (often_ns, seldom_ns):
        truth = T_other_world @ interpolate(TRUTH.stamps_ns, TRUTH.T_world_body, stamps_ns)
        result = evaluate(replace(records, true_poses=poses_of(stamps_ns, truth)))
        assert at_json(result, "closures.precision") == at_json(result, "closures.recall") == 1.0
        assert (
            abs(int(str(at_json(result, "closures.revisit_count"))) - len(REVISITS)) <= 2
        )  # at the turn and at the end
        assert at_json(result, "closures.p95_translation_error_m") == pytest.approx(0.0, abs=1e-6)
        ate_m = at_json(result, "trajectory.ate_m")
        assert ate_m == pytest.approx(at_json(plain, "trajectory.ate_m"), abs=0.02)


def test_one_pose() -> None:
    one = drive()
    assert one.trajectory is not None
    one = replace(
        one,
        trajectory=TrajectoryRecord(0, "map", TRUTH.stamps_ns[:1], TRUTH.T_world_body[:1]),
        online_poses=one.online_poses[:1],
        odometry=one.odometry[:1],
        true_poses=one.true_poses[:1],
        graph=graph(TRUTH.stamps_ns[:1], TRUTH.T_world_body[:1]),
    )
    result = evaluate(one)
    assert "at least 2" in result.unavailable["trajectory"]
    assert at_json(result, "closures.revisit_count") == 0
    assert at_json(result, "relocalization.lost_time_ratio") is None
    assert printed(result)


def test_every_key_about_places_is_documented() -> None:
    text = (Path(__file__).parents[3] / "docs" / "evaluation.md").read_text(encoding="utf-8")
    results = evaluate(EvaluationRecords()).to_json_dict()
    parts = [results[name] for name in ("closures", "relocalization")]
    keys = {key for part in parts for key in part if not key.startswith("revisit_count_")}
    assert len(keys) > 50
    assert {key for key in keys if key not in text} == set()
    losses = evaluate(replace(drive(), statuses=(StatusRecord(at_ns(0), "LOST", "warning", ""),))).results[
        "relocalization"
    ]
    assert {key for key in losses["losses"][0] if f"`{key}`" not in text} == set()
