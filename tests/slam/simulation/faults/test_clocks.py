from __future__ import annotations

import numpy as np
import pytest

from logs.messages import DetectionTruth, ObjectDetections, Odometry
from slam.common.geometry import apply
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.registry import parse_faults
from tests.slam.simulation.faults.streams import (
    COUNT,
    HALF_NS,
    IDS,
    PERIOD_NS,
    STAMPS_NS,
    T_BODY_SENSOR,
    drive,
    faulty,
    poses,
    records,
    stamps,
)


@pytest.mark.parametrize(
    ("fault", "shift_ns"), [("detections_late=0.25", 250_000_000), ("detections_early=2", -2_000_000_000)]
)
def test_stamps_of_scans_and_their_true_ids_are_shifted(fault: str, shift_ns: int) -> None:
    changed = faulty(fault)
    assert np.array_equal(stamps(changed, ObjectDetections), STAMPS_NS + shift_ns)
    assert np.array_equal(stamps(changed, DetectionTruth), STAMPS_NS + shift_ns)
    assert np.array_equal(stamps(changed, Odometry), STAMPS_NS)
    assert [e.log_time_ns for e in changed] == [e.log_time_ns for e in drive()]


def test_a_stamp_before_zero_cannot_be() -> None:
    assert len(records(faulty("detections_early=55"), ObjectDetections)) == COUNT - 50


def test_the_clock_goes_back_at_half_time() -> None:
    shifts = stamps(faulty("detections_clock_back=30"), ObjectDetections) - STAMPS_NS
    assert np.array_equal(shifts, np.where(STAMPS_NS >= HALF_NS, -30 * 10**9, 0))


def test_stamps_in_microseconds() -> None:
    changed = faulty("stamps_in_microseconds")
    assert np.array_equal(stamps(changed, ObjectDetections), STAMPS_NS // 1000)
    assert np.array_equal(stamps(changed, Odometry), STAMPS_NS)


def test_scans_are_thinned_to_a_rate() -> None:
    changed = faulty("scan_rate=2")
    assert np.array_equal(stamps(changed, ObjectDetections), STAMPS_NS[::5])
    assert np.array_equal(stamps(changed, DetectionTruth), STAMPS_NS[::5])
    assert len(records(changed, Odometry)) == COUNT


def test_a_lower_frame_rate_thins_all() -> None:
    changed = faulty("frame_rate=1")
    for kind in (ObjectDetections, DetectionTruth, Odometry):
        assert np.array_equal(stamps(changed, kind), STAMPS_NS[::10])


def test_a_higher_frame_rate_fills_in() -> None:
    changed = faulty("frame_rate=100")
    expected = np.arange(STAMPS_NS[0], STAMPS_NS[-1] + 1, PERIOD_NS // 10)
    for kind in (ObjectDetections, DetectionTruth, Odometry):
        assert np.array_equal(stamps(changed, kind), expected)
    assert all(truth.object_ids == IDS for truth in records(changed, DetectionTruth))
    # What is repeated stands still in the frame of the odometry.
    T_odom_sensor = poses(changed) @ T_BODY_SENSOR
    standing = [apply(T, s.positions) for T, s in zip(T_odom_sensor, records(changed, ObjectDetections), strict=True)]
    assert standing[3] == pytest.approx(standing[0])
    assert standing[13] == pytest.approx(standing[10])


def test_the_rate_as_it_is_changes_nothing() -> None:
    changed = apply_faults(drive(), parse_faults(["frame_rate=10"]), seed=0)
    assert len(changed) == len(drive())
