"""Whole drives: what comes out is true where the input is, and is never better than the input allows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from logs.messages import (
    DetectionAssociations,
    DetectionTruth,
    GroundTruthPose,
    ObjectDetections,
    ObjectMapRecord,
    Odometry,
    Record,
    SlamPose,
    StatusRecord,
    Transform,
)
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.common.geometry import invert, transform_from_xyz_yaw
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.evaluation.inputs.synchronization import clean_poses
from slam.evaluation.metrics.association import find_aliases, identify_landmarks, label_detections
from slam.final_map import FinalMap
from slam.simulation.config import DriveConfig, KidnapConfig, SimulationConfig
from slam.system import Slam
from tests.helpers.short_drives import (
    EXACT,
    EXACT_SENSOR,
    NO_DRIFT,
    Entry,
    block_world,
    change,
    drive,
    keep_until,
    map_in_memory,
    odometry_of,
    records_of,
    run,
)

pytestmark = pytest.mark.slow

TRUTHS = (GroundTruthPose, DetectionTruth, ObjectMapRecord)


def finished(entries: list[Entry], config: Config | None = None) -> FinalMap:
    return map_in_memory(entries, config).finish()


def associations_of(entries: list[Entry], config: Config | None = None) -> list[DetectionAssociations]:
    slam = Slam(config or Config())
    updates = [update for _, _, record in entries for update in slam.process(record)]
    return [update for update in updates if isinstance(update, DetectionAssociations)]


def truth_of_landmarks(
    entries: list[Entry], object_map: ObjectMapRecord, config: Config | None = None
) -> dict[str, str]:
    """True object of each landmark, by the detections that were assigned to it."""
    path = clean_poses(
        np.array([o.stamp_ns for o in odometry_of(entries)]), np.array([o.T_odom_body for o in odometry_of(entries)])
    )
    truths = [record for _, _, record in entries if isinstance(record, DetectionTruth)]
    labelled = label_detections(associations_of(entries, config), truths, path, aliases=find_aliases(object_map))
    return identify_landmarks(labelled)


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


def by_sector(entries: Iterable[Entry], sensors: int) -> list[Entry]:
    """Each scan as messages of several sensors, of which each sees one sector around the body."""
    found = list[Entry]()
    for topic, log_time_ns, record in entries:
        if not isinstance(record, ObjectDetections):
            found.append((topic, log_time_ns, record))
            continue
        bearings = np.arctan2(record.positions[:, 1], record.positions[:, 0])
        sector = np.floor((bearings + np.pi) / (2.0 * np.pi) * sensors).astype(np.int64) % sensors
        for number in range(sensors):
            rows = np.flatnonzero(sector == number)
            part = replace(
                record,
                stamp_ns=record.stamp_ns + number,
                positions=record.positions[rows],
                labels=tuple(record.labels[row] for row in rows),
                scores=record.scores[rows],
            )
            found.append((topic, log_time_ns, part))
    return found


def test_several_sensors_that_each_see_a_sector_map_all_objects(tmp_path):
    """Each object is in one of three messages only, and is no less certain for that."""
    slow = drive(EXACT.model_copy(update={"drive": DriveConfig(rate_hz=5.0)}))
    entries = [entry for entry in by_sector(slow, 3) if not isinstance(entry[2], DetectionTruth)]
    run(entries, tmp_path / "out.mcap")
    (found,) = records_of(tmp_path / "out.mcap", "/slam/map")
    assert isinstance(found, ObjectMapRecord)
    assert sum(state == "confirmed" for state in found.states) >= 0.95 * len(block_world().object_ids)


def test_odometry_that_is_a_fifth_too_long_is_corrected(exact_drive, tmp_path):
    def stretch(_: int, odometry: Odometry) -> Odometry:
        T = odometry.T_odom_body.copy()
        T[:3, 3] *= 1.2
        return replace(odometry, T_odom_body=T)

    stretched = change(exact_drive, Odometry, stretch)
    found = run(stretched, tmp_path / "out.mcap")
    assert found.odometry.ate_m > 2.0
    assert found.estimate.ate_m < 0.01


# With noise


def test_with_default_noise_detections_go_to_the_right_landmarks(noisy_output):
    found = evaluate(read_records(noisy_output))
    assert found.results["associations"]["precision"] > 0.995
    assert found.results["associations"]["recall"] > 0.99
    assert found.results["landmarks"]["precision"] == 1.0
    assert found.results["landmarks"]["landmarks_per_object"] < 1.1
    assert found.estimate.ate_m < 0.6 * found.odometry.ate_m
    assert found.results["landmarks"]["p95_error_m"] < 0.1


def test_with_default_noise_landmarks_hold_the_trajectory(noisy_output, tmp_path):
    """Mean of two drives, because the odometry of one drifts little by chance."""
    drives = [evaluate(read_records(noisy_output)), run(drive(SimulationConfig(), seed=2), tmp_path / "2.mcap")]
    odometry_m = sum(each.odometry.ate_m for each in drives)
    assert sum(each.online.ate_m for each in drives) < 0.5 * odometry_m
    assert sum(each.estimate.ate_m for each in drives) < 0.2 * odometry_m


# What moves


def overtaken(entries: list[Entry]) -> list[Entry]:
    """The drive, which overtakes a vehicle on its left every 8 s: it is 20 m ahead, and at last 20 m behind."""
    start_ns = next(record.stamp_ns for _, _, record in entries if isinstance(record, ObjectDetections))

    def passing(_: int, record: Record) -> Record:
        number, since_s = divmod((record.stamp_ns - start_ns) * 1e-9, 8.0)
        if isinstance(record, DetectionTruth):
            return replace(record, object_ids=(*record.object_ids, f"moving-{number:g}"))
        assert isinstance(record, ObjectDetections)
        return replace(
            record,
            positions=np.vstack([record.positions, [20.0 - 5.0 * since_s, 3.0, 0.0]]),
            labels=(*record.labels, "vehicle"),
            scores=np.append(record.scores, 0.9),
            covariances=np.concatenate([record.covariances, 0.01 * np.eye(3)[None]]),
        )

    return change(change(entries, ObjectDetections, passing), DetectionTruth, passing)


def confirmed_objects(entries: list[Entry], config: Config | None = None) -> list[str]:
    object_map = finished(entries, config).object_map
    objects = truth_of_landmarks(entries, object_map, config)
    return sorted(
        objects[name] for name, state in zip(object_map.ids, object_map.states, strict=True) if state == "confirmed"
    )


def test_what_moves_is_not_confirmed_and_what_is_parked_is():
    found = confirmed_objects(overtaken(drive(SimulationConfig(), seed=1)))
    assert not [name for name in found if name.startswith("moving")]
    assert "vehicle" in block_world().labels
    assert set(block_world().object_ids) <= set(found)


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


# Frames and order


def test_detections_between_two_odometry_messages_are_placed_between_them(exact_drive):
    """Every second odometry message is left out, none of the detections."""
    entries = keep_until(exact_drive, 4.0)
    sparse = change(entries, Odometry, lambda i, odometry: odometry if i % 2 == 0 else None)
    result = finished(sparse)
    assert result.status.counters["detections_used"] == result.status.counters["odometry_used"] * 2 - 1
    world = block_world()
    nearest = [np.linalg.norm(world.positions - position, axis=1).min() for position in result.object_map.positions]
    assert max(nearest) < 0.02


def test_detections_that_are_logged_before_the_odometry_of_their_time_are_all_used(exact_drive):
    entries = keep_until(exact_drive, 4.0)
    swapped = sorted(entries, key=lambda entry: (entry[1], isinstance(entry[2], Odometry)))
    a, b = finished(entries), finished(swapped)
    assert b.status.counters["detections_used"] == 40
    np.testing.assert_allclose(a.object_map.positions, b.object_map.positions, atol=1e-6)


# What it says meanwhile


def test_there_is_a_pose_for_every_odometry_message_and_it_agrees_with_the_frames(noisy_drive):
    slam = Slam(Config())
    updates = [update for _, _, record in keep_until(noisy_drive, 5.0) for update in slam.process(record)]
    odometry = odometry_of(keep_until(noisy_drive, 5.0))
    poses = [update for update in updates if isinstance(update, SlamPose)]
    assert [pose.stamp_ns for pose in poses] == [o.stamp_ns for o in odometry]
    for pose, o in zip(poses, odometry, strict=True):
        np.testing.assert_allclose(pose.T_map_body, pose.T_map_odom @ o.T_odom_body, atol=1e-12)
    frames = [update for update in updates if isinstance(update, Transform) and update.parent_frame_id == "map"]
    steps_told = [update for update in updates if isinstance(update, Transform) and update.parent_frame_id == "odom"]
    assert [step.stamp_ns for step in steps_told] == [o.stamp_ns for o in odometry]
    assert len(frames) == slam.counters["keyframes"]
    assert {(frame.parent_frame_id, frame.child_frame_id) for frame in frames} == {("map", "odom")}


SHORT_SIGHTED_KIDNAP = SimulationConfig(odometry=NO_DRIFT, sensor=EXACT_SENSOR.model_copy(update={"max_range_m": 12.0}))


def kidnapped(config: SimulationConfig) -> list[Entry]:
    return drive(config.model_copy(update={"kidnap": KidnapConfig(from_m=60.0, to_m=100.0, gap_s=30.0)}))


def test_kidnapping_within_view_of_known_landmarks_is_followed():
    entries = kidnapped(EXACT)
    final = finished(entries)
    assert "odometry_breaks" not in final.status.counters
    truth = {record.stamp_ns: record.T_world_body for _, _, record in entries if isinstance(record, GroundTruthPose)}
    T_true = np.array([truth[stamp_ns] for stamp_ns in final.trajectory.stamps_ns.tolist()])
    T_world_map = T_true[0] @ invert(final.trajectory.T_map_body[0])
    np.testing.assert_allclose(T_world_map @ final.trajectory.T_map_body, T_true, atol=0.02)


@pytest.mark.parametrize(
    "config", [SimulationConfig(), SHORT_SIGHTED_KIDNAP], ids=["default noise", "without noise, short-sighted"]
)
def test_kidnapping_is_reported_and_both_parts_are_mapped(config):
    entries = kidnapped(config)
    slam = Slam(Config())
    told = [u for _, _, record in entries for u in slam.process(record) if isinstance(u, StatusRecord)]
    # The second part may meet objects of the first: then it is told that the robot was relocalized, too.
    assert [status.level for status in told][:2] == ["info", "warning"]
    assert all(status.level == "info" for status in told[2:])
    final = slam.finish()
    assert final.status.counters["odometry_breaks"] == 1
    assert final.graph.edge_kinds.count("discontinuity") == 1
    assert "covariances_missing" not in final.status.counters
    assert np.linalg.eigvalsh(final.object_map.covariances)[:, 0].min() > 0.0
    assert len(final.trajectory.stamps_ns) == len(odometry_of(entries))
    assert np.isfinite(final.trajectory.T_map_body).all()


def steps(T: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1))


def test_the_final_trajectory_has_no_steps_that_the_odometry_has_not(noisy_drive, noisy_output):
    (trajectory,) = records_of(noisy_output, "/slam/trajectory_stamped")
    T_odom = np.array([o.T_odom_body for o in odometry_of(noisy_drive)])
    assert np.abs(steps(trajectory.T_map_body) - steps(T_odom)).max() < 0.1


def test_nothing_at_all_cannot_be_mapped():
    with pytest.raises(InputDataError, match="no odometry"):
        Slam(Config()).finish()
