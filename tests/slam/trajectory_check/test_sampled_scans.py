"""The sample of the scans of a drive."""

from __future__ import annotations

import numpy as np
import pytest

from slam.trajectory_check import sampled_scans
from slam.trajectory_check.sampled_scans import SampledScan, ScanSample


@pytest.fixture(autouse=True)
def _few_detections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampled_scans, "MAX_DETECTIONS", 100)


def scan(index: int, detections: int) -> SampledScan:
    return SampledScan(
        index, np.zeros((detections, 3)), np.zeros(detections, dtype=np.int64), 0.0, np.eye(4), np.eye(4)
    )


def test_short_drive_is_kept_whole_but_for_empty_scans() -> None:
    sample = ScanSample()
    for index in range(10):
        sample.add(scan(index, index % 2))
    assert [kept.stamp_ns for kept in sample.scans] == [1, 3, 5, 7, 9]


def test_long_drive_is_sampled_evenly_within_bound() -> None:
    sample = ScanSample()
    for index in range(1000):
        sample.add(scan(index, 5))
    stamps = np.array([kept.stamp_ns for kept in sample.scans])
    assert 10 <= len(stamps) <= 20
    assert len(set(np.diff(stamps))) == 1
    assert stamps[-1] > 900
