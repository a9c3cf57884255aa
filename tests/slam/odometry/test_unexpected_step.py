"""Steps that are not to be expected: held back, and how the track goes on after them."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from logs.messages import Odometry
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import transform_from_xyz_yaw, yaw_rad
from slam.odometry.noise import step_variances
from slam.odometry.pose import OdometryPose
from slam.odometry.track import OdometryTrack
from slam.odometry.unexpected_step import Continuation, Correction

CONFIG = OdometryCalibration()
RATE_HZ, SPEED_MPS = 10, 5.0


def message(step: int, *, turned_rad: float = 0.0, aside_m: float = 0.0) -> Odometry:
    """A drive straight ahead whose speed varies a little, said to be somewhere else."""
    x = SPEED_MPS * step / RATE_HZ + 0.01 * np.sin(step)
    start_m = SPEED_MPS * 99.5 / RATE_HZ  # what is turned, is turned here
    T = transform_from_xyz_yaw(np.array([start_m, aside_m, 0.0]), turned_rad)
    return Odometry(10**9 + step * 10**9 // RATE_HZ, T @ transform_from_xyz_yaw(np.array([x - start_m, 0.0, 0.0]), 0.0))


def driven(steps: int = 100) -> tuple[OdometryTrack, Counter[str]]:
    counters = Counter[str]()
    track = OdometryTrack(counters)
    for step in range(steps):
        assert len(track.add(message(step))) == (step > 0) + (step == 1)
    return track, counters


def test_a_step_as_before_is_taken_at_once():
    track, _ = driven()
    assert len(track.add(message(100, turned_rad=0.0001))) == 1
    assert track.unexpected is None


@pytest.mark.parametrize("jump", [{"turned_rad": 0.5}, {"aside_m": 1.0}, {"aside_m": 100.0}])
def test_a_jump_is_held_back_with_what_follows(jump):
    track, _ = driven()
    latest = track.latest
    assert track.add(message(100, **jump)) == track.add(message(101, **jump)) == []
    assert track.latest is latest
    assert track.unexpected.span_ns == (message(100).stamp_ns, message(101).stamp_ns)


def test_a_wild_message_is_left_out():
    track, counters = driven()
    assert track.add(message(100, turned_rad=2.0, aside_m=1000.0)) == []
    (pose,) = track.add(message(101))
    np.testing.assert_array_equal(pose.T_odom_body, message(101).T_odom_body)
    assert track.unexpected is None
    assert pose.segment == 0
    assert counters["odometry_wild"] == 1


def held(**jump: float) -> OdometryTrack:
    track, _ = driven()
    for step in (100, 101, 102):
        track.add(message(step, **jump))
    return track


def test_after_a_mended_jump_the_track_goes_on_as_if_there_had_been_none():
    track = held(turned_rad=0.5)
    before = track.latest
    poses = track.resolve(Continuation.EXPECTED)
    assert len(poses) == 3
    for step, pose in zip((100, 101, 102), poses, strict=True):
        np.testing.assert_allclose(pose.T_odom_body, message(step).T_odom_body, atol=0.03)
        reported = message(step, turned_rad=0.5).T_odom_body
        np.testing.assert_allclose(pose.T_odom_reported @ reported, pose.T_odom_body, atol=1e-9)
        assert pose.segment == before.segment
    assert poses[-1].travel_m - before.travel_m == pytest.approx(1.5, abs=0.05)
    usual, mended = step_variances(poses[0], poses[1], CONFIG), step_variances(before, poses[0], CONFIG)
    assert np.all(mended[[0, 2]] > 1.5 * usual[[0, 2]]), "what was mended is less certain"


def test_a_step_that_is_right_is_taken_as_it_is():
    track = held(turned_rad=0.5)
    poses = track.resolve(Continuation.REPORTED)
    assert [pose.segment for pose in poses] == [0, 0, 0]
    assert float(yaw_rad(poses[0].T_odom_body)) == pytest.approx(0.5)


def test_a_broken_track_begins_a_segment():
    poses = held(aside_m=100.0).resolve(Continuation.BROKEN)
    assert [pose.segment for pose in poses] == [1, 1, 1]


@pytest.mark.parametrize(
    ("jump", "way"),
    [({"aside_m": 100.0}, Continuation.BROKEN), ({"turned_rad": 0.5}, Continuation.REPORTED)],
)
def test_without_detections_only_what_is_beyond_the_limits_breaks_the_track(jump, way):
    assert held(**jump).unexpected.default is way


def test_poses_at_the_time_of_a_scan_differ_by_the_jump():
    poses = held(aside_m=100.0).unexpected.at(message(100).stamp_ns + 5 * 10**7)
    apart = poses[Continuation.REPORTED].T_odom_body[:3, 3] - poses[Continuation.EXPECTED].T_odom_body[:3, 3]
    assert apart == pytest.approx([0.0, 100.0, 0.0], abs=0.05)


def test_a_silence_is_held_back_until_it_is_overdue():
    track, _ = driven()
    later = [message(step) for step in range(400, 700)]
    added = [pose for each in later[:5] for pose in track.add(each)]
    assert added == []
    assert not track.unexpected.is_overdue
    assert track.unexpected.default is Continuation.BROKEN
    for each in later[5:]:
        track.add(each)
    assert track.unexpected.is_overdue


def test_a_second_jump_while_one_is_open_is_held_back_in_its_turn():
    track = held(turned_rad=0.5)
    for step in (103, 104):
        track.add(message(step, turned_rad=1.5))
    assert len(track.resolve(Continuation.EXPECTED)) == 3
    assert track.unexpected.span_ns[0] == message(103).stamp_ns


def test_asking_costs_the_same_however_long_it_waits(monkeypatch):
    made = Counter[str]()

    def counted(pose: OdometryPose, **changes: object) -> OdometryPose:
        made["poses"] += 1
        return replace(pose, **changes)

    for module in ("slam.odometry.track", "slam.odometry.unexpected_step"):
        monkeypatch.setattr(f"{module}.replace", counted)
    track = held(aside_m=100.0)
    costs = []
    for step in range(102, 180):
        made.clear()
        track.add(message(step, aside_m=100.0))
        track.unexpected.at(message(step - 1).stamp_ns + 5 * 10**7)
        costs.append(made["poses"])
    assert set(costs) == {costs[0]}


def frozen(steps: int = 3) -> tuple[OdometryTrack, Counter[str]]:
    """The odometry repeats the pose of step 99 at a speed of 5 m/s."""
    track, counters = driven()
    for step in range(100, 100 + steps):
        track.add(Odometry(message(step).stamp_ns, message(99).T_odom_body))
    return track, counters


def test_an_odometry_that_repeats_a_pose_is_expected_to_go_on():
    track, _ = frozen()
    assert track.unexpected.is_frozen
    assert not held(aside_m=1.0).unexpected.is_frozen
    poses = track.unexpected.at(message(102).stamp_ns)
    assert poses[Continuation.EXPECTED].T_odom_body[0, 3] == pytest.approx(message(102).T_odom_body[0, 3], abs=0.1)
    np.testing.assert_array_equal(poses[Continuation.REPORTED].T_odom_body, message(99).T_odom_body)


def test_a_correction_moves_the_pose_that_was_expected_and_says_how_uncertain_it_is():
    track, counters = frozen()
    expected = track.unexpected.first_poses[Continuation.EXPECTED].T_odom_body
    T = transform_from_xyz_yaw(np.array([0.1, -0.2, 0.0]), 0.01)
    (pose,) = track.resolve(Continuation.EXPECTED, Correction(T, np.array([0.04, 1e-4])))
    np.testing.assert_allclose(pose.T_odom_body, T @ expected, atol=1e-12)
    assert (pose.mended_m2, pose.mended_rad2) == pytest.approx((0.04, 1e-4))
    assert counters["odometry_frozen"] == 1
    assert track.unexpected is not None, "the next message repeats the pose, too"


def test_a_frozen_odometry_stays_so_while_the_body_stands_until_it_reports_motion():
    track, _ = frozen(steps=2)
    unmoved = Correction(np.eye(4), np.full(2, 1e-6))
    track.resolve(Continuation.EXPECTED, unmoved)
    track.resolve(Continuation.REPORTED)
    for step in range(102, 110):
        track.add(Odometry(message(step).stamp_ns, message(99).T_odom_body))
        assert track.unexpected.is_frozen
        assert Continuation.EXPECTED in track.unexpected.first_poses
        track.resolve(Continuation.REPORTED)
    moved = transform_from_xyz_yaw(np.array([0.05, 0.0, 0.0]), 0.0)
    for step in range(110, 120):
        track.add(Odometry(message(step).stamp_ns, message(99).T_odom_body @ moved))
        if track.unexpected is not None:
            assert not track.unexpected.is_frozen
            track.resolve(Continuation.REPORTED)
    track.add(Odometry(message(120).stamp_ns, message(99).T_odom_body @ moved))
    assert track.unexpected is None


def test_one_repeated_pose_is_left_out_and_no_fault():
    track, counters = frozen(steps=1)
    (pose,) = track.add(message(101))
    np.testing.assert_array_equal(pose.T_odom_body, message(101).T_odom_body)
    assert counters["odometry_wild"] == counters["odometry_frozen"] == 0


def test_a_body_that_has_stopped_at_once_may_do_so_again():
    track, _ = frozen(steps=2)
    assert not track.unexpected.goes_on_frozen
    for _ in range(2):
        if track.unexpected is not None:
            track.resolve(Continuation.REPORTED)
    assert track.unexpected is None
    for step in range(102, 110):
        track.add(Odometry(message(step).stamp_ns, message(99).T_odom_body))
        assert track.unexpected is None


def test_a_body_that_has_stopped_at_once_may_start_at_once():
    track, _ = frozen(steps=2)
    while track.unexpected is not None:
        track.resolve(Continuation.REPORTED)
    for step in range(102, 104):
        track.add(Odometry(message(step).stamp_ns, message(99).T_odom_body))
    ahead = transform_from_xyz_yaw(np.array([0.4, 0.0, 0.0]), 0.0)
    assert len(track.add(Odometry(message(104).stamp_ns, message(99).T_odom_body @ ahead))) == 1


def test_a_body_that_stands_under_a_frozen_odometry_does_not_make_stops_usual():
    track, _ = frozen()
    track.resolve(Continuation.EXPECTED)
    while track.unexpected is not None:
        track.resolve(Continuation.REPORTED)
    ahead = transform_from_xyz_yaw(np.array([0.0, 0.4, 0.0]), 0.0)
    assert track.add(Odometry(message(103).stamp_ns, message(99).T_odom_body @ ahead)) == []
    assert track.unexpected is not None
