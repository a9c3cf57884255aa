"""The track of the odometry: interpolation, disorder, breaks and corrections."""

from collections import Counter

import numpy as np
import pytest

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration, DetectionCalibration
from slam.common.geometry import invert
from slam.odometry.track import HISTORY, Correction, OdometryTrack
from tests.helpers.poses import pose_at

START_NS = 1_700_000_000_000_000_000


def odometry(seconds: float, x: float, yaw: float = 0.0) -> Odometry:
    return Odometry(START_NS + round(seconds * 1e9), pose_at(x, yaw=yaw))


def track(
    *steps: tuple[float, float], counters: Counter[str] | None = None, sensor_range_m: float = 30.0
) -> OdometryTrack:
    calibration = Calibration(detection=DetectionCalibration(sensor_range_m=sensor_range_m))
    made = OdometryTrack(calibration, Counter() if counters is None else counters)
    for seconds, x in steps:
        made.add(odometry(seconds, x))
    made.finish()
    return made


def x_at(made: OdometryTrack, seconds: float) -> float | None:
    pose = made.at(START_NS + round(seconds * 1e9))
    return None if pose is None else float(pose.T_odom_body[0, 3])


def test_pose_between_two_messages_is_interpolated():
    made = track((0, 0), (1, 10), (2, 30))
    assert x_at(made, 0.25) == pytest.approx(2.5)
    assert x_at(made, 1.5) == pytest.approx(20.0)
    assert made.at(START_NS + 1_500_000_000).travel_m == pytest.approx(20.0)


def test_pose_at_a_message_is_that_of_the_message_bit_for_bit():
    made = track()
    first, second = odometry(0, 0.1, 0.3), odometry(0.1, 0.7, 0.4)
    made.add(first)
    made.add(second)
    np.testing.assert_array_equal(made.at(first.stamp_ns).T_odom_body, first.T_odom_body)
    np.testing.assert_array_equal(made.at(second.stamp_ns).T_odom_body, second.T_odom_body)


def test_track_has_no_pose_outside_its_time():
    assert track().latest is None
    assert x_at(track(), 0.0) is None
    made = track((0, 0), (1, 1))
    assert x_at(made, -1e-9) is None
    assert x_at(made, 1 + 1e-9) is None


@pytest.mark.parametrize(("seconds", "x"), [(9.0, 1000.0), (30.0, 1.0), (9.0, -1000.0)])
def test_silence_and_a_jump_over_one_begin_a_segment(seconds, x):
    made = track((0, 0), (1, 1), (seconds, x), (seconds + 1, x + 1))
    assert made.latest.segment == 1
    assert made.latest.travel_m == pytest.approx(2.0)
    assert x_at(made, 0.5) == pytest.approx(0.5)
    assert x_at(made, 0.5 * (1 + seconds)) is None
    assert x_at(made, seconds) == x
    assert x_at(made, seconds + 0.5) == pytest.approx(x + 0.5)


def test_fast_drive_and_short_silence_are_no_break():
    made = track((0, 0), (1, 49), (10.9, 60))
    assert made.latest.segment == 0
    assert made.latest.travel_m == pytest.approx(60.0)


def test_oldest_poses_are_dropped():
    made = track(*((0.01 * i, 0.1 * i) for i in range(HISTORY + 100)))
    assert x_at(made, 0.0) is None
    assert x_at(made, 0.01 * (HISTORY + 50)) == pytest.approx(0.1 * (HISTORY + 50))


@pytest.mark.parametrize(
    ("sensor_range_m", "step", "breaks"),
    [(30.0, (2.0, 3.5), 0), (1.5, (2.0, 3.5), 1), (1.5, (11.9, 31.0), 0), (1.5, (11.9, 33.9), 1)],
)
def test_limit_of_a_step_scales_with_the_sensor_range(sensor_range_m, step, breaks):
    """At once an acceleration, after a while two sensor ranges per second."""
    known = ((0.1 * step, 0.1 * step) for step in range(20))  # the speed before the first step is not
    counters = Counter[str]()
    made = track(*known, step, counters=counters, sensor_range_m=sensor_range_m)
    assert made.latest.segment + counters["odometry_corrected"] == breaks


@pytest.mark.parametrize(("sensor_range_m", "travel_m"), [(30.0, 0.0), (1.5, 0.05)])
def test_jitter_scales_with_the_sensor_range(sensor_range_m, travel_m):
    made = track((0.0, 0.0), (0.1, 0.03), (0.2, 0.01), sensor_range_m=sensor_range_m)
    assert made.latest.travel_m == pytest.approx(travel_m)


def test_duplicates_and_late_messages_are_counted():
    counters = Counter[str]()
    made = track((0, 0), (1, 5), (2, 10), (2, 99), (1.5, 99), counters=counters)
    assert x_at(made, 1.5) == pytest.approx(7.5)
    assert (made.latest.stamp_ns, made.latest.travel_m) == (START_NS + 2_000_000_000, pytest.approx(10.0))
    assert counters == {"odometry_duplicated": 1, "odometry_out_of_order": 1}


def test_messages_before_time_zero_are_dropped():
    counters = Counter[str]()
    before_zero_s = -1.0 - START_NS * 1e-9
    made = track((before_zero_s, 0), (before_zero_s + 0.5, 0), (0, 0), (1, 5), (2, 10), counters=counters)
    assert (made.latest.segment, made.latest.travel_m) == (0, pytest.approx(10.0))
    assert counters == {"odometry_before_time_zero": 2}


def test_single_stamp_from_the_future_is_no_silence():
    made = track((0, 0), (1, 1), (1000, 2), (2, 2), (3, 3))
    assert (made.latest.segment, made.latest.travel_m) == (0, pytest.approx(3.0))
    assert made.latest.stamp_ns == START_NS + 3_000_000_000


@pytest.mark.parametrize("seconds", [1.0, 5.0, 20.0])
def test_descending_stamps_add_no_poses(seconds):
    """The first of them lies in the future, and the last just after the last good one."""
    counters = Counter[str]()
    made = track(counters=counters)
    late = [odometry(2.0 + seconds - 0.1 * i, 2.0 + 0.1 * i) for i in range(round(10 * seconds))]
    after = [odometry(2.0 + seconds + 0.1 * i, 2.0 + seconds + 0.1 * i) for i in range(1, 5)]
    good = [odometry(0.1 * i, 0.1 * i) for i in range(20)]
    added = [pose for message in [*good, *late, *after] for pose in made.add(message)] + made.finish()
    right = [(pose.stamp_ns - START_NS) * 1e-9 for pose in added]
    assert right == pytest.approx([0.1 * i for i in range(20)] + [2.0 + seconds + 0.1 * i for i in range(1, 5)])
    assert counters["odometry_out_of_order"] == len(late)


# Corrections

VARIANCES = np.array([0.04, 1e-4, 4e-4])
JUMP_STEP = 103


def message(step: int, T_jump: FloatArray | None = None) -> Odometry:
    """A drive along x at 5 m/s, 10 messages a second, whose poses ``T_jump`` (4, 4) moves from ``JUMP_STEP`` on."""
    T = pose_at(0.5 * step + 0.01 * np.sin(step))
    T = T_jump @ T if T_jump is not None and step >= JUMP_STEP else T
    return Odometry(START_NS + step * 10**8, T)


def stamp_ns(step: float) -> int:
    return START_NS + round(step * 1e8)


def jump(y: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """A jump where the body is at ``JUMP_STEP``."""
    there = pose_at(0.5 * JUMP_STEP)
    return np.asarray(there @ pose_at(0.0, y, yaw=yaw) @ invert(there))


def jumped(T_jump: FloatArray, *, until: int = 108) -> tuple[OdometryTrack, Counter[str]]:
    counters = Counter[str]()
    made = track(counters=counters)
    for step in range(until):
        made.add(message(step, T_jump))
    return made, counters


@pytest.mark.parametrize(("T_jump", "first"), [(jump(yaw=0.5), 106), (jump(y=1.0), 107)], ids=["turn", "shift"])
def test_correction_moves_the_track_from_its_time(T_jump: FloatArray, first: int) -> None:
    made, counters = jumped(T_jump)
    made.correct(stamp_ns(first - 0.5), Correction(invert(T_jump), VARIANCES), segment=0)
    straight, as_it_was = jumped(np.eye(4))[0], jumped(T_jump)[0]
    for step in (99, 102, 103, 105, 106, 107):
        found, expected = made.at(stamp_ns(step)), (straight if step >= first else as_it_was).at(stamp_ns(step))
        np.testing.assert_allclose(found.T_odom_body, expected.T_odom_body, atol=1e-9)
        assert found.segment == 0
        np.testing.assert_array_equal(found.corrected, VARIANCES if step >= first else np.zeros(3))
    assert counters["odometry_corrected"] == 1


def test_messages_after_a_correction_are_corrected_as_well() -> None:
    T_jump = jump(y=1.0, yaw=2.0)
    made, _ = jumped(T_jump)
    made.correct(stamp_ns(102.5), Correction(invert(T_jump), VARIANCES), segment=0)
    (pose,) = made.add(message(108, T_jump))
    np.testing.assert_allclose(pose.T_odom_body, message(108).T_odom_body, atol=1e-9)
    np.testing.assert_allclose(pose.T_odom_reported @ message(108, T_jump).T_odom_body, pose.T_odom_body, atol=1e-9)
    np.testing.assert_array_equal(pose.corrected, VARIANCES)
    assert pose.travel_m == pytest.approx(jumped(np.eye(4), until=109)[0].latest.travel_m)
    assert pose.segment == 0


def test_correction_moves_the_track_from_a_break_before_it_and_the_next_break_stays() -> None:
    """The messages are silent for 2 s twice, and jump."""
    made, _ = jumped(np.eye(4), until=JUMP_STEP)
    for step in range(JUMP_STEP, JUMP_STEP + 9):
        silences, y = (1, 100.0) if step < JUMP_STEP + 5 else (2, 300.0)
        made.add(Odometry(stamp_ns(step + 20 * silences), message(step, jump(y)).T_odom_body))
    assert made.latest.segment == 2
    made.correct(stamp_ns(JUMP_STEP + 22.5), Correction(invert(jump(y=100.0)), VARIANCES), segment=0)
    poses = [made.at(stamp_ns(step)) for step in (JUMP_STEP - 1, JUMP_STEP + 20, JUMP_STEP + 24, JUMP_STEP + 45)]
    assert [pose.segment for pose in poses] == [0, 0, 0, 1]
    np.testing.assert_allclose(poses[1].T_odom_body, message(JUMP_STEP).T_odom_body, atol=1e-9)
    assert poses[2].travel_m == pytest.approx(jumped(np.eye(4))[0].latest.travel_m)


@pytest.mark.parametrize("before", [1, JUMP_STEP])
def test_single_wild_message_is_dropped(before: int) -> None:
    made, counters = jumped(np.eye(4), until=before)
    made.add(Odometry(stamp_ns(before), pose_at(0.0, 1000.0, yaw=2.0)))
    (pose,) = made.add(message(before + 1))
    np.testing.assert_array_equal(pose.T_odom_body, message(before + 1).T_odom_body)
    assert pose.segment == 0
    assert counters == {"odometry_wild": 1}


def test_body_goes_on_as_before_where_two_messages_are_far_off() -> None:
    made, counters = jumped(np.eye(4), until=JUMP_STEP)
    T_jump = jump(y=1000.0, yaw=2.0)
    assert made.add(message(JUMP_STEP, T_jump)) == []
    poses = made.add(message(JUMP_STEP + 1, T_jump))
    for step, pose in enumerate(poses):
        np.testing.assert_allclose(pose.T_odom_body, message(JUMP_STEP + step).T_odom_body, atol=0.02)
        assert pose.segment == 0
        np.testing.assert_allclose(pose.corrected, [0.25, 0.0, 0.0], atol=0.01)  # by as much as it moves in a step
    assert len(poses) == 2
    assert counters == {"odometry_corrected": 1}


def test_body_goes_on_as_since_the_last_break() -> None:
    made, _ = jumped(np.eye(4), until=JUMP_STEP)
    for step in range(JUMP_STEP, JUMP_STEP + 8):
        T_jump = jump(y=100.0 if step < JUMP_STEP + 4 else 1000.0)
        made.add(Odometry(stamp_ns(step + 20), message(step, T_jump).T_odom_body))
    assert made.latest.segment == 1
    expected = message(JUMP_STEP + 7, jump(y=100.0)).T_odom_body
    np.testing.assert_allclose(made.latest.T_odom_body, expected, atol=0.05)


def test_body_goes_on_as_before_where_two_jumps_are_near() -> None:
    made, counters = jumped(jump(y=5.0))
    for step in range(108, 112):
        made.add(message(step, jump(y=10.0)))
    np.testing.assert_allclose(made.latest.T_odom_body, message(111).T_odom_body, atol=0.05)
    assert counters == {"odometry_corrected": 2}


def test_last_message_counts_even_if_it_is_far_off() -> None:
    made, _ = jumped(np.eye(4), until=JUMP_STEP)
    made.add(message(JUMP_STEP, jump(y=1000.0)))
    (pose,) = made.finish()
    np.testing.assert_allclose(pose.T_odom_body, message(JUMP_STEP).T_odom_body, atol=0.02)


@pytest.mark.parametrize(("after", "before"), [(0, 2), (2, 1)], ids=["travel", "time"])
def test_break_before_a_past_pose(after: int, before: int) -> None:
    made, _ = jumped(np.eye(4), until=JUMP_STEP)
    stamps_ns = [message(JUMP_STEP - steps).stamp_ns for steps in (3, 2, 1)]
    travel_m = [pose.travel_m for stamp_ns in stamps_ns if (pose := made.at(stamp_ns))]
    assert made.break_after(travel_m[after], before_ns=stamps_ns[before]) == stamps_ns[1]
    segments = [pose.segment for stamp_ns in stamps_ns if (pose := made.at(stamp_ns))]
    assert segments == [0, 1, 1]
    assert made.at(stamps_ns[1] - 1) is None
    assert [made.add(message(step))[0].segment for step in (JUMP_STEP, JUMP_STEP + 1)] == [1, 1]
