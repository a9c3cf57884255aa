"""The trajectories of a drive, collected scan by scan."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from logs.messages import TrajectoryRecord
from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration
from slam.common.geometry import transform_from_xyz_yaw
from slam.frontend.tracker import Tracked
from slam.odometry.pose import OdometryPose
from slam.trajectory_check import judgement
from slam.trajectory_check.judgement import DriveCheck, TrajectoryCheck
from tests.slam.trajectory_check.drives import RANGE_M, SIGMA_M, circle, drifting, scans_of

CALIBRATION = Calibration().with_values({"detection.sensor_range_m": RANGE_M, "objects.landmark_sigma_m": SIGMA_M})


MOVED = transform_from_xyz_yaw(np.array([3.0, -4.0, 0.0]), 0.7)


def checked(T_true: FloatArray, T_online: FloatArray, *, scans: int, empty: int = 0) -> DriveCheck:
    """A drive whose track was moved as a whole by a correction: ``T_odom_reported`` leads back to what was reported.

    The first ``empty`` scans have no detection.
    """
    check = DriveCheck(CALIBRATION)
    for scan, T_map_body in zip(scans_of(T_true)[:scans], T_online, strict=False):
        positions = scan.positions[: 0 if scan.stamp_ns < empty else None]
        tracked = SimpleNamespace(scan=SimpleNamespace(positions=positions), labels=scan.labels)
        corrected = MOVED if scan.stamp_ns > len(T_true) // 2 else np.eye(4)
        pose = OdometryPose(scan.stamp_ns, corrected @ T_true[scan.stamp_ns], scan.travel_m, 0, 1.0, corrected)
        check.add(cast(Tracked, tracked), pose, T_map_body)
    return check


def judged(T_true: FloatArray, T_online: FloatArray, T_final: FloatArray, *, scans: int) -> TrajectoryCheck:
    check = checked(T_true, T_online, scans=scans)
    return check.judge(TrajectoryRecord(0, "map", np.arange(len(T_final)), T_final))


def test_long_drive_is_sampled_evenly_within_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    T = circle()
    most = sum(len(scan.positions) for scan in scans_of(T)) // 3
    monkeypatch.setattr(judgement, "MAX_DETECTIONS", most)
    kept = checked(T, T, scans=len(T))._scans
    assert most // 3 < sum(len(scan.positions) for scan in kept) <= most
    assert set(np.diff([scan.stamp_ns for scan in kept]).tolist()) == {4}
    assert len(T) - kept[-1].stamp_ns <= 4


def test_odometry_is_judged_as_reported() -> None:
    T = circle()
    result = judged(T, drifting(T, 3.0), drifting(T, 6.0), scans=len(T))
    assert result.better == "odometry"
    assert "the odometry is significantly better" in str(result)
    assert result.gains["odometry"] > result.gains["online"] > result.gains["final"]


@pytest.mark.parametrize("scans", [0, 1])
def test_drive_with_hardly_any_scan_cannot_be_judged(scans: int) -> None:
    T = circle()
    assert judged(T, T, T, scans=scans) == TrajectoryCheck()


def test_empty_scans_are_not_kept() -> None:
    T = circle()
    assert [scan.stamp_ns for scan in checked(T, T, scans=9, empty=7)._scans] == [7, 8]


def test_scans_beyond_final_trajectory_are_left_out() -> None:
    T = circle()
    whole, cut = (judged(T, T, T[:count], scans=len(T)) for count in (len(T), len(T) - 40))
    assert 0 < cut.detections < whole.detections
