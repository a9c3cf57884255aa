"""Drives with faulty input: refused with an error of ours, or mapped, and the final status counts what was lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry as FoxgloveOdometry

from logs.messages import ObjectDetections, Odometry, Transform
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.common.geometry import transform_from_xyz_yaw
from slam.replay import ReplaySummary, replay
from tests.helpers.short_drives import (
    Entry,
    change,
    final_status,
    in_frame,
    keep_until,
    raw_messages,
    records_of,
    replay_or_refuse,
    write_log,
    write_raw,
)

pytestmark = pytest.mark.slow

SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module")
def entries(noisy_drive: list[Entry]) -> list[Entry]:
    """Eight seconds, 80 odometry messages and 80 scans."""
    return keep_until(noisy_drive, 8.0)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "out.mcap"


def mapped(entries: list[Entry], output: Path, config: Config | None = None) -> dict[str, int]:
    """Counters of the final status, after a replay that must succeed and leave sound numbers."""
    replay(write_log(output.with_name("in.mcap"), entries), output, config or Config())
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    (object_map,) = records_of(output, "/slam/map")
    assert np.isfinite(trajectory.T_map_body).all()
    assert np.isfinite(object_map.positions).all()
    return final_status(output).counters


def test_a_truncated_log_is_mapped_where_a_chunk_is_left(noisy_log, tmp_path, output):
    whole = noisy_log.read_bytes()
    source = tmp_path / "in.mcap"
    source.write_bytes(whole[: 3 * len(whole) // 4])
    result = replay_or_refuse(source, output)
    assert isinstance(result, ReplaySummary)
    assert 50 < result.counters["odometry_used"] < 304


# Time


def after_a_pause(entries: list[Entry], kinds: tuple[type, ...]) -> list[Entry]:
    """What comes after four seconds comes a minute later; of ``kinds`` nothing comes in between."""
    start_ns = entries[0][1]

    def delayed(entry: Entry) -> Entry:
        topic, ns, record = entry
        if ns - start_ns < 4 * SECOND_NS:
            return entry
        return topic, ns + 60 * SECOND_NS, replace(record, stamp_ns=record.stamp_ns + 60 * SECOND_NS)

    late = [delayed(entry) for entry in entries]
    waiting = [
        ("/odom", o.stamp_ns + i * SECOND_NS // 10, replace(o, stamp_ns=o.stamp_ns + i * SECOND_NS // 10))
        for o in [
            next(e[2] for e in reversed(entries) if isinstance(e[2], Odometry) and e[1] - start_ns < 4 * SECOND_NS)
        ]
        for i in range(1, 600)
        if Odometry not in kinds
    ]
    return sorted([*late, *waiting], key=lambda entry: entry[1])


def test_a_minute_without_a_message_breaks_nothing_if_the_same_objects_are_seen_afterwards(entries, output):
    counters = mapped(after_a_pause(entries, (Odometry, ObjectDetections)), output)
    assert "odometry_breaks" not in counters
    assert counters["odometry_used"] == counters["detections_used"] == 80


def test_a_minute_without_a_message_breaks_the_track_if_other_objects_are_seen_afterwards(entries, output):
    away = np.array([3.1, 2.3, 0.0])

    def elsewhere(i, record):
        return replace(record, positions=record.positions[:, [1, 0, 2]] + away) if i >= 40 else record

    changed = change(entries, ObjectDetections, elsewhere)
    counters = mapped(after_a_pause(changed, (Odometry, ObjectDetections)), output)
    assert counters["odometry_breaks"] == 1


def test_a_minute_without_detections_while_the_body_waits_breaks_nothing(entries, output):
    counters = mapped(after_a_pause(entries, (ObjectDetections,)), output)
    assert "odometry_breaks" not in counters
    assert counters["odometry_used"] == 80 + 599
    assert counters["detections_used"] == 80


def test_a_body_that_stands_still_for_a_minute_is_mapped(entries, output):
    first = {type(record): (topic, record) for topic, _, record in reversed(entries)}
    start_ns = entries[0][1]
    still = []
    for i in range(600):
        ns = start_ns + i * SECOND_NS // 10
        still += [
            (topic, ns, replace(record, stamp_ns=ns)) for topic, record in (first[Odometry], first[ObjectDetections])
        ]
    counters = mapped(still, output)
    assert counters["detections_used"] == 600
    assert counters["keyframes"] <= 13
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    np.testing.assert_allclose(trajectory.T_map_body, np.tile(np.eye(4), (600, 1, 1)), atol=1e-3)


def test_detections_before_the_first_odometry_are_counted(entries, output):
    counters = mapped(change(entries, Odometry, lambda i, record: record if i >= 20 else None), output)
    assert counters["detections_without_odometry"] == 20
    assert counters["detections_used"] == 60


def test_odometry_that_ends_early_leaves_the_rest_of_the_detections_out(entries, output):
    counters = mapped(change(entries, Odometry, lambda i, record: record if i < 50 else None), output)
    assert counters["detections_without_odometry"] == 30
    assert counters["detections_used"] == 50


def test_a_single_odometry_message_is_a_map_of_one_keyframe(entries, output):
    counters = mapped(change(entries, Odometry, lambda i, record: record if i == 0 else None), output)
    assert counters["keyframes"] == counters["detections_used"] == 1


# Poses


def with_pose(
    entries: list[Entry], output: Path, alter: Callable[[FoxgloveOdometry], None], every: int
) -> dict[str, int]:
    """Counters of a replay in which each ``every``-th odometry message was changed as it stands in the file."""
    source = write_log(output.with_name("whole.mcap"), entries)
    messages, count = [], 0
    for raw in raw_messages(source):
        if raw.topic == "/odom":
            if count % every == every - 1:
                message = FoxgloveOdometry.FromString(raw.data)
                alter(message)
                raw = replace(raw, data=message.SerializeToString(deterministic=True))
            count += 1
        messages.append(raw)
    changed = write_raw(output.with_name("in.mcap"), messages)
    replay(changed, output, Config())
    return final_status(output).counters


def test_poses_that_are_not_finite_are_left_out_and_counted(entries, output):
    def alter(message: FoxgloveOdometry) -> None:
        message.pose.position.y = float("nan")

    counters = with_pose(entries, output, alter, every=8)
    assert counters["invalid_messages"] == 10
    assert counters["odometry_used"] == 70
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    assert np.isfinite(trajectory.T_map_body).all()


def scale_quaternion(factor: float) -> Callable[[FoxgloveOdometry], None]:
    def alter(message: FoxgloveOdometry) -> None:
        q = message.pose.orientation
        q.x, q.y, q.z, q.w = factor * q.x, factor * q.y, factor * q.z, factor * q.w

    return alter


def test_if_no_pose_is_any_good_nothing_is_mapped(entries, output):
    with pytest.raises(InputDataError, match="no odometry message was usable"):
        with_pose(entries, output, scale_quaternion(0.0), every=1)
    assert not output.exists()


@pytest.mark.parametrize("xyz", [(1e7, -1e7, 100.0), (500_000.0, 5_400_000.0, 300.0)], ids=["1e7 m", "UTM"])
def test_huge_coordinates_give_the_same_map_elsewhere(entries, output, xyz):
    T = transform_from_xyz_yaw(np.array(xyz), 0.0)
    here = mapped(entries, output)
    (map_here,) = records_of(output, "/slam/map")
    moved = change(entries, Odometry, lambda i, record: replace(record, T_odom_body=T @ record.T_odom_body))
    there = mapped(moved, output)
    (map_there,) = records_of(output, "/slam/map")
    assert here["landmarks_confirmed"] == there["landmarks_confirmed"]
    assert map_here.ids == map_there.ids
    np.testing.assert_allclose(map_there.positions - T[:3, 3], map_here.positions, atol=0.01)


# Frames


def test_a_static_transform_leads_to_it(entries, output):
    mount = ("/tf_static", entries[0][1], Transform(entries[0][1], "base_link", "velodyne", np.eye(4)))
    counters = mapped([mount, *in_frame(entries, "velodyne")], output)
    assert counters["detections_used"] == 80


def test_what_came_before_its_transform_is_placed_by_it(entries, output):
    start_ns = entries[0][1]
    mount = ("/tf_static", start_ns + 2 * SECOND_NS, Transform(start_ns, "base_link", "velodyne", np.eye(4)))
    counters = mapped(sorted([*in_frame(entries, "velodyne"), mount], key=lambda entry: entry[1]), output)
    assert counters["detections_used"] == 80


# Detections


def altered_scans(
    entries: list[Entry], alter: Callable[[int, ObjectDetections], ObjectDetections | None]
) -> list[Entry]:
    return change(entries, ObjectDetections, alter)


def replaced(detections: ObjectDetections, positions, labels) -> ObjectDetections:
    positions = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    return ObjectDetections(detections.stamp_ns, detections.frame_id, positions, tuple(labels), np.ones(len(positions)))


def test_a_label_that_was_never_seen_before_joins_the_vocabulary(entries, output):
    def rename(i: int, detections: ObjectDetections) -> ObjectDetections:
        new = tuple("fire hydrant" if label == "tree" else label for label in detections.labels)
        return replace(detections, labels=new) if i >= 40 else detections

    mapped(altered_scans(entries, rename), output)
    (object_map,) = records_of(output, "/slam/map")
    assert object_map.vocabulary[-1] == "fire hydrant"
    assert set(object_map.vocabulary) == {"bench", "lamp", "tree", "vehicle", "fire hydrant"}
    np.testing.assert_allclose(object_map.class_probabilities.sum(axis=1), 1.0)


def test_messages_without_a_detection_are_scans_like_others(entries, output):
    counters = mapped(altered_scans(entries, lambda i, d: replaced(d, [], []) if i % 3 == 1 else d), output)
    assert counters["detections_used"] == 80


def test_if_nothing_is_ever_seen_the_odometry_is_the_result(entries, output):
    counters = mapped(altered_scans(entries, lambda i, d: replaced(d, [], [])), output)
    assert counters["landmarks_confirmed"] == counters["objects_used"] == 0
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    odometry = [record for _, _, record in entries if isinstance(record, Odometry)]
    np.testing.assert_allclose(trajectory.T_map_body, [o.T_odom_body for o in odometry], atol=1e-6)


def test_five_thousand_detections_in_a_message(entries, output):
    rng = np.random.default_rng(0)

    def crowd(i: int, detections: ObjectDetections) -> ObjectDetections:
        positions = np.concatenate([rng.uniform(-50, 50, (5000, 2)), np.zeros((5000, 1))], axis=1)
        return replaced(detections, positions, ["tree"] * 5000) if i in (40, 41) else detections

    counters = mapped(altered_scans(entries, crowd), output)
    assert counters["objects_used"] >= 10_000
    assert counters["detections_used"] == 80


def test_two_objects_at_the_very_same_place_are_two(entries, output):
    """A sign and the lamp post that it hangs on; the body stands."""
    start = next(record for _, _, record in entries if isinstance(record, Odometry))
    still = change(entries, Odometry, lambda i, record: replace(record, T_odom_body=start.T_odom_body))
    place = [[8.0, 3.0, 0.0]] * 2
    mapped(altered_scans(still, lambda i, d: replaced(d, place, ["sign", "lamp"])), output)
    (object_map,) = records_of(output, "/slam/map")
    confirmed = [
        label for label, state in zip(object_map.labels, object_map.states, strict=True) if state == "confirmed"
    ]
    assert sorted(confirmed) == ["lamp", "sign"]


@pytest.mark.parametrize("value", [np.nan, 1e300])
def test_positions_that_are_no_places_are_left_out(entries, output, value):
    def spoil(i: int, detections: ObjectDetections) -> ObjectDetections:
        positions = detections.positions.copy()
        positions[0, 0] = value
        return replace(detections, positions=positions)

    counters = mapped(altered_scans(entries, spoil), output)
    assert counters["detections_used"] == 80
    assert counters.get("dropped_objects", 0) + counters["objects_filtered"] == 80


@pytest.mark.parametrize("sigma_m", [1e-9, 1e9])
def test_covariances_that_are_absurd_do_not_break_the_solver(entries, output, sigma_m):
    def claim(i: int, detections: ObjectDetections) -> ObjectDetections:
        return replace(detections, covariances=np.tile(sigma_m**2 * np.eye(3), (len(detections.labels), 1, 1)))

    source = write_log(output.with_name("in.mcap"), altered_scans(entries, claim))
    summary = replay_or_refuse(source, output)
    assert isinstance(summary, ReplaySummary)
    assert summary.counters["detections_used"] == sum(isinstance(record, ObjectDetections) for _, _, record in entries)
