"""The odometry's track: interpolation, disorder, and breaks."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from logs.messages import Odometry
from slam.common.geometry import relative, transform_from_xyz_yaw
from slam.odometry.track import HISTORY, OdometryTrack

START_NS = 1_700_000_000_000_000_000


def odometry(seconds: float, x: float, yaw: float = 0.0) -> Odometry:
    return Odometry(START_NS + round(seconds * 1e9), transform_from_xyz_yaw(np.array([x, 0.0, 0.0]), yaw))


def track(*steps: tuple[float, float]) -> OdometryTrack:
    made = OdometryTrack()
    for seconds, x in steps:
        made.add(odometry(seconds, x))
    made.finish()
    return made


def x_at(made: OdometryTrack, seconds: float) -> float | None:
    pose = made.at(START_NS + round(seconds * 1e9))
    return None if pose is None else float(pose.T_odom_body[0, 3])


def test_a_pose_between_two_messages_is_between_them():
    made = track((0, 0), (1, 10), (2, 30))
    assert x_at(made, 0.25) == pytest.approx(2.5)
    assert x_at(made, 1.5) == pytest.approx(20.0)
    assert made.at(START_NS + 1_500_000_000).travel_m == pytest.approx(20.0)


def test_at_a_message_it_is_that_message_bit_for_bit():
    made = OdometryTrack()
    first, second = odometry(0, 0.1, 0.3), odometry(0.1, 0.7, 0.4)
    made.add(first)
    made.add(second)
    np.testing.assert_array_equal(made.at(first.stamp_ns).T_odom_body, first.T_odom_body)
    np.testing.assert_array_equal(made.at(second.stamp_ns).T_odom_body, second.T_odom_body)


def test_outside_of_its_time_it_knows_nothing():
    assert OdometryTrack().latest is None
    assert x_at(OdometryTrack(), 0.0) is None
    made = track((0, 0), (1, 1))
    assert x_at(made, -1e-9) is None
    assert x_at(made, 1 + 1e-9) is None


def test_duplicates_and_messages_out_of_order_leave_it_as_it_was():
    made = track((0, 0), (1, 5))
    latest = made.latest
    assert made.add(odometry(1, 99)) == []
    assert made.add(odometry(0.5, 99)) == []
    assert made.latest is latest
    assert x_at(made, 0.5) == pytest.approx(2.5)


@pytest.mark.parametrize(("seconds", "x"), [(1.1, 200.0), (30.0, 1.0), (1.1, -100.0)])
def test_a_jump_and_a_silence_break_the_track(seconds, x):
    made = track((0, 0), (1, 1), (seconds, x), (seconds + 1, x + 1))
    assert made.latest.segment == 1
    assert made.latest.travel_m == pytest.approx(2.0)
    assert x_at(made, 0.5) == pytest.approx(0.5)
    assert x_at(made, 0.5 * (1 + seconds)) is None
    assert x_at(made, seconds) == x
    assert x_at(made, seconds + 0.5) == pytest.approx(x + 0.5)


def test_a_fast_drive_and_a_short_silence_are_no_break():
    made = track((0, 0), (1, 49), (10.9, 60))
    assert made.latest.segment == 0
    assert made.latest.travel_m == pytest.approx(60.0)


def test_travel_is_the_path_and_not_the_distance():
    assert track((0, 0), (1, 3), (2, 0.5), (3, 3)).latest.travel_m == pytest.approx(8.0)


def test_the_oldest_poses_are_let_go():
    made = track(*((0.01 * i, 0.1 * i) for i in range(HISTORY + 100)))
    assert x_at(made, 0.0) is None
    assert x_at(made, 0.01 * (HISTORY + 50)) == pytest.approx(0.1 * (HISTORY + 50))


def test_the_relative_pose_leads_from_one_to_the_other():
    a, b = transform_from_xyz_yaw(np.array([1.0, 2, 0]), 0.5), transform_from_xyz_yaw(np.array([3.0, 1, 0]), -2.0)
    np.testing.assert_allclose(a @ relative(a, b), b, atol=1e-12)


def segments(*steps: tuple[float, float]) -> list[int]:
    made = OdometryTrack()
    poses = [pose for seconds, x in steps for pose in made.add(odometry(seconds, x))]
    return [pose.segment for pose in (*poses, *made.finish())]


def test_odometry_that_is_started_again_near_where_it_was_is_a_break():
    """Carried off for 5 s while it thinks to be 8 m from its start: the step back there would be no jump."""
    driven = [(0.1 * i, 5.0 + 0.8 * i) for i in range(11)]
    assert segments(*driven, (6.0, 5.0), (6.1, 5.8)) == [0] * 11 + [1, 1]
    assert segments(*driven, (6.0, 0.0), (6.1, 0.8)) == [0] * 11 + [1, 1], "at the identity"
    assert segments(*driven, (6.0, 5.001), (6.1, 5.8)) == [0] * 13, "twin: only near its start"


def test_who_drives_or_stands_at_the_start_of_its_odometry_goes_on():
    there_and_back = [*range(11), *range(9, -1, -1), -1, -2]
    assert segments(*((0.1 * i, 0.5 * x) for i, x in enumerate(there_and_back))) == [0] * len(there_and_back)
    assert segments(*((0.1 * i, 0.0) for i in range(5)), (3.0, 0.0), (3.1, 0.4)) == [0] * 7


@pytest.mark.parametrize(("sensor_range_m", "breaks"), [(30.0, 0), (1.5, 1)])
def test_what_is_a_jump_depends_on_how_far_the_sensor_sees(sensor_range_m, breaks):
    made = OdometryTrack(sensor_range_m=sensor_range_m)
    for step in range(20):  # the speed before the first step is not known
        made.add(odometry(0.1 * step, 0.1 * step))
    made.add(odometry(2.0, 3.5))
    made.finish()
    assert made.latest.segment == breaks


@pytest.mark.parametrize(("sensor_range_m", "travel_m"), [(30.0, 0.0), (1.5, 0.05)])
def test_what_is_jitter_depends_on_how_far_the_sensor_sees(sensor_range_m, travel_m):
    made = OdometryTrack(sensor_range_m=sensor_range_m)
    for seconds, x in ((0.0, 0.0), (0.1, 0.03), (0.2, 0.01)):
        made.add(odometry(seconds, x))
    assert made.latest.travel_m == pytest.approx(travel_m)


def test_what_comes_again_or_late_is_counted_wherever_it_says_that_the_body_is():
    counters = Counter[str]()
    made = OdometryTrack(counters)
    for seconds, x in ((0, 0), (1, 5), (2, 10), (2, 10), (1.5, 7.5)):
        made.add(odometry(seconds, x))
    assert made.latest is not None
    assert (made.latest.stamp_ns, made.latest.travel_m) == (START_NS + 2_000_000_000, pytest.approx(10.0))
    assert counters == {"odometry_duplicated": 1, "odometry_out_of_order": 1}


def test_messages_from_before_time_zero_are_left_out():
    counters = Counter[str]()
    made = OdometryTrack(counters)
    before_zero_s = -1.0 - START_NS * 1e-9
    for seconds in (before_zero_s, before_zero_s + 0.5, 0, 1, 2):
        made.add(odometry(seconds, 0.0 if seconds < 0 else 5.0 * seconds))
    assert made.latest is not None
    assert (made.latest.segment, made.latest.travel_m) == (0, pytest.approx(10.0))
    assert counters == {"odometry_before_time_zero": 2}


def test_one_stamp_from_the_future_is_no_silence():
    made = OdometryTrack()
    for seconds, x in ((0, 0), (1, 1), (1000, 2), (2, 2), (3, 3)):
        made.add(odometry(seconds, x))
    assert made.latest is not None
    assert (made.latest.segment, made.latest.travel_m) == (0, pytest.approx(3.0))
    assert made.latest.stamp_ns == START_NS + 3_000_000_000


@pytest.mark.parametrize("seconds", [1.0, 5.0, 20.0])
def test_stamps_that_run_backwards_for_a_while_add_nothing(seconds):
    """The first of them lies in the future, and the last just after the last good one."""
    counters = Counter[str]()
    made = OdometryTrack(counters)
    late = [odometry(2.0 + seconds - 0.1 * i, 2.0 + 0.1 * i) for i in range(round(10 * seconds))]
    after = [odometry(2.0 + seconds + 0.1 * i, 2.0 + seconds + 0.1 * i) for i in range(1, 5)]
    good = [odometry(0.1 * i, 0.1 * i) for i in range(20)]
    added = [pose for message in [*good, *late, *after] for pose in made.add(message)] + made.finish()
    right = [(pose.stamp_ns - START_NS) * 1e-9 for pose in added]
    assert right == pytest.approx([0.1 * i for i in range(20)] + [2.0 + seconds + 0.1 * i for i in range(1, 5)])
    assert counters["odometry_out_of_order"] == len(late)
