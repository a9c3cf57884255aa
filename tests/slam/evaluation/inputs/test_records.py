"""Truth in the text formats of others."""

from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.messages import FloatArray, Odometry
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.inputs.records import read_records
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.formats.trajectories import write_kitti
from tests.helpers.short_drives import write_log

STAMPS_NS = 10**9 * (1_700_000_000 + np.arange(30))
T_CAMERA_BODY = np.array([[0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, -0.2], [1.0, 0.0, 0.0, 0.3], [0.0, 0.0, 0.0, 1.0]])


def circle(radius_m: float = 10.0) -> FloatArray:
    """Forward along a circle, (30, 4, 4)."""
    angles = np.linspace(0.0, 5.0, len(STAMPS_NS))
    xyz = radius_m * np.stack([np.sin(angles), 1.0 - np.cos(angles), np.zeros(len(angles))], axis=1)
    return transform_from_xyz_yaw(xyz, angles)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The odometry of the circle."""
    poses = zip(STAMPS_NS.tolist(), circle(9.8), strict=True)
    return write_log(tmp_path / "log.mcap", [("/odom", stamp_ns, Odometry(stamp_ns, T)) for stamp_ns, T in poses])


def assert_circle(poses: PoseSeries) -> None:
    np.testing.assert_array_equal(poses.stamps_ns, STAMPS_NS)
    np.testing.assert_allclose(poses.T_world_body, circle(), atol=1e-9)


def test_poses_without_stamps_are_at_those_of_the_odometry(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "00.txt"
    write_kitti(path, circle())
    assert_circle(read_records(log, reference=path).true_path)
    write_kitti(path, circle()[:20])
    with pytest.raises(DatasetError, match="without stamps"):
        read_records(log, reference=path)


def test_poses_of_the_camera_are_those_of_the_body_by_its_calibration(log: Path, tmp_path: Path) -> None:
    path, calib = tmp_path / "00.txt", tmp_path / "calib.txt"
    write_kitti(path, np.asarray(T_CAMERA_BODY @ circle() @ np.linalg.inv(T_CAMERA_BODY)))
    calib.write_text(f"Tr: {' '.join(map(repr, T_CAMERA_BODY[:3].ravel().tolist()))}\n")
    assert_circle(read_records(log, reference=path, calib=calib).true_path)
