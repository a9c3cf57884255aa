"""Truth in the text formats of others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.messages import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.inputs.text_reference import read_text_reference
from slam.formats.trajectories import write_kitti, write_tum

STAMPS_NS = 10**9 * (1_700_000_000 + np.arange(30, dtype=np.int64))
T_CAMERA_BODY = np.array([[0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, -0.2], [1.0, 0.0, 0.0, 0.3], [0.0, 0.0, 0.0, 1.0]])


def circle(radius_m: float = 10.0) -> FloatArray:
    """Forward along a circle, (30, 4, 4)."""
    angles = np.linspace(0.0, 5.0, len(STAMPS_NS))
    xyz = radius_m * np.stack([np.sin(angles), 1.0 - np.cos(angles), np.zeros(len(angles))], axis=1)
    return transform_from_xyz_yaw(xyz, angles)


ODOMETRY = PoseSeries(STAMPS_NS, circle(9.8))


def camera_poses() -> FloatArray:
    return np.asarray(T_CAMERA_BODY @ circle() @ np.linalg.inv(T_CAMERA_BODY))


def assert_circle(poses: PoseSeries) -> None:
    np.testing.assert_array_equal(poses.stamps_ns, STAMPS_NS)
    np.testing.assert_allclose(poses.T_world_body, circle(), atol=1e-9)


def test_poses_without_stamps_are_at_those_of_the_odometry(tmp_path: Path) -> None:
    path = tmp_path / "00.txt"
    write_kitti(path, circle())
    assert_circle(read_text_reference(path, None, ODOMETRY))
    with pytest.raises(DatasetError, match="without stamps"):
        read_text_reference(path, None, PoseSeries(STAMPS_NS[:20], circle()[:20]))


def test_poses_of_the_camera_need_its_calibration(tmp_path: Path) -> None:
    path, calib = tmp_path / "00.txt", tmp_path / "calib.txt"
    write_kitti(path, camera_poses())
    calib.write_text(f"Tr: {' '.join(map(repr, T_CAMERA_BODY[:3].ravel().tolist()))}\n")
    assert_circle(read_text_reference(path, calib, ODOMETRY))
    with pytest.raises(
        EvaluationError, match=r"00\.txt: the direction of travel differs .* by 9. deg .*; give --calib"
    ):
        read_text_reference(path, None, ODOMETRY)


def test_axes_are_not_checked_without_common_motion(tmp_path: Path) -> None:
    path = tmp_path / "gt.tum"
    write_tum(path, STAMPS_NS, circle())
    assert_circle(read_text_reference(path, None, ODOMETRY))
    assert_circle(read_text_reference(path, None, PoseSeries(STAMPS_NS + 10**15, circle())))
    assert_circle(read_text_reference(path, None, PoseSeries(STAMPS_NS, np.tile(np.eye(4), (len(STAMPS_NS), 1, 1)))))
