from __future__ import annotations

import numpy as np
import pytest

from logs.messages import DetectionTruth, ObjectDetections, Odometry
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.registry import parse_faults
from tests.slam.simulation.faults.streams import (
    COUNT,
    HALF_NS,
    STAMPS_NS,
    drive,
    faulty,
    records,
    stamps,
)


@pytest.mark.parametrize(("fault", "shift_ns"), [("time_offset=0.25", 250_000_000), ("time_offset=-2", -2_000_000_000)])
def test_stamps_of_scans_and_their_true_ids_are_shifted(fault: str, shift_ns: int) -> None:
    changed = faulty(fault)
    assert np.array_equal(stamps(changed, ObjectDetections), STAMPS_NS + shift_ns)
    assert np.array_equal(stamps(changed, DetectionTruth), STAMPS_NS + shift_ns)
    assert np.array_equal(stamps(changed, Odometry), STAMPS_NS)
    assert [e.log_time_ns for e in changed] == [e.log_time_ns for e in drive()]


def test_a_stamp_before_zero_cannot_be() -> None:
    assert len(records(faulty("time_offset=-55"), ObjectDetections)) == COUNT - 50


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


def test_the_rate_as_it_is_changes_nothing() -> None:
    changed = apply_faults(drive(), parse_faults(["frame_rate=10"]), seed=0)
    assert len(changed) == len(drive())


def test_the_clock_of_the_odometry_goes_back_at_half_time() -> None:
    changed = faulty("odometry_clock_back=3")
    assert np.array_equal(stamps(changed, Odometry), STAMPS_NS - 3 * 10**9 * (STAMPS_NS >= HALF_NS))
    assert np.array_equal(stamps(changed, ObjectDetections), STAMPS_NS)
    assert [e.log_time_ns for e in changed] == [e.log_time_ns for e in drive()]


def test_a_slow_clock_falls_behind_more_and_more() -> None:
    behind = STAMPS_NS - stamps(faulty("detections_clock_slow=1000"), ObjectDetections)
    assert np.array_equal(behind, (STAMPS_NS - STAMPS_NS[0]) // 1000)


def test_coarse_stamps_are_multiples() -> None:
    found = stamps(faulty("stamps_coarse=0.5"), ObjectDetections)
    assert np.array_equal(found, STAMPS_NS // 500_000_000 * 500_000_000)
    assert np.array_equal(stamps(faulty("stamps_coarse=0.5"), Odometry), STAMPS_NS)


def test_a_gap_in_all() -> None:
    kept = (STAMPS_NS < HALF_NS) | (STAMPS_NS >= HALF_NS + 2 * 10**9)
    for kind in (Odometry, ObjectDetections, DetectionTruth):
        assert np.array_equal(stamps(faulty("log_gap=2"), kind), STAMPS_NS[kept])


def test_each_message_comes_twice() -> None:
    for kind in (Odometry, ObjectDetections):
        assert np.array_equal(stamps(faulty("messages_twice"), kind), np.repeat(STAMPS_NS, 2))
    assert len(records(faulty("messages_twice"), DetectionTruth)) == COUNT
