"""Whole drives: what comes out is true where the input is, and is never better than the input allows."""

from dataclasses import replace

import numpy as np
import pytest

from logs.messages import DetectionTruth, GroundTruthPose, ObjectMapRecord, SlamPose, Transform
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.final_map import FinalMap
from slam.system import Slam
from tests.helpers.short_drives import Entry, block_world, keep_until, map_in_memory, odometry_of, run

pytestmark = pytest.mark.slow

TRUTHS = (GroundTruthPose, DetectionTruth, ObjectMapRecord)


def finished(entries: list[Entry]) -> FinalMap:
    return map_in_memory(entries).finish()


# Without noise


def test_without_noise_everything_is_where_and_what_it_is(exact_drive, tmp_path):
    found = run(exact_drive, tmp_path / "out.mcap")
    assert found.estimate.ate_m < 1e-6
    assert found.online.ate_m < 1e-6
    assert found.results["associations"]["precision"] == 1.0
    # What was seen once from afar and then hidden for long may begin again.
    assert found.results["associations"]["recall"] > 0.999
    assert found.results["landmarks"]["confirmed_count"] == len(block_world().object_ids)
    assert found.results["landmarks"]["landmarks_per_object"] == 1.0
    assert found.results["landmarks"]["max_error_m"] < 1e-6
    assert found.results["landmarks"]["global_median_error_m"] < 1e-6
    assert found.results["landmarks"]["class_accuracy"] == 1.0


# With noise


def test_with_default_noise_detections_go_to_the_right_landmarks(noisy_output):
    found = evaluate(read_records(noisy_output))
    assert found.results["associations"]["precision"] > 0.995
    assert found.results["associations"]["recall"] > 0.99
    assert found.results["landmarks"]["precision"] == 1.0
    assert found.results["landmarks"]["landmarks_per_object"] < 1.1
    assert found.estimate.ate_m < 0.6 * found.odometry.ate_m
    assert found.results["landmarks"]["p95_error_m"] < 0.1


# The truth is never read


def same_results(a: FinalMap, b: FinalMap) -> None:
    np.testing.assert_array_equal(a.trajectory.T_map_body, b.trajectory.T_map_body)
    np.testing.assert_array_equal(a.object_map.positions, b.object_map.positions)
    assert a.object_map.states == b.object_map.states
    assert a.status.counters == b.status.counters


def altered(record):
    """A truth record turned into an untruth."""
    match record:
        case GroundTruthPose():
            return replace(
                record, T_world_body=transform_from_xyz_yaw(np.array([9.0, 9, 9]), 1.0) @ record.T_world_body
            )
        case DetectionTruth():
            return replace(record, object_ids=tuple("liar" for _ in record.object_ids))
        case ObjectMapRecord():
            return replace(record, positions=record.positions + 50.0)


def test_without_truth_or_with_another_truth_the_result_is_the_same(noisy_drive):
    entries = keep_until(noisy_drive, 10.0)
    reference = finished(entries)
    without = [entry for entry in entries if not isinstance(entry[2], TRUTHS)]
    untrue = [(t, ns, altered(r) if isinstance(r, TRUTHS) else r) for t, ns, r in entries]
    assert len(without) < len(entries)
    same_results(reference, finished(without))
    same_results(reference, finished(untrue))


# What it says meanwhile


def test_there_is_a_pose_for_every_odometry_message_and_it_agrees_with_the_frames(noisy_drive):
    entries = keep_until(noisy_drive, 5.0)
    slam, T = Slam(Config().calibrated({"odometry.roll_deg": 5.0})), {"map": np.eye(4), "odom": np.eye(4)}
    stamps_ns: dict[str, list[int]] = {"pose": [], "map": [], "odom": []}
    for update in (update for _, _, record in entries for update in slam.process(record)):
        if isinstance(update, SlamPose):
            np.testing.assert_allclose(update.T_map_body, T["map"] @ T["odom"], atol=1e-12)
            stamps_ns["pose"].append(update.stamp_ns)
        elif isinstance(update, Transform):
            T[update.parent_frame_id] = update.T_parent_child
            stamps_ns[update.parent_frame_id].append(update.stamp_ns)
    assert stamps_ns["pose"] == stamps_ns["odom"] == [o.stamp_ns for o in odometry_of(entries)]
    assert len(stamps_ns["map"]) == slam.counters["keyframes"]
    np.testing.assert_allclose(T["odom"], odometry_of(entries)[-1].T_odom_body, atol=1e-9)
    assert T["map"][2, 2] == pytest.approx(np.cos(np.deg2rad(5.0)), abs=1e-3)


def test_nothing_at_all_cannot_be_mapped():
    with pytest.raises(InputDataError, match="no odometry"):
        Slam(Config()).finish()
