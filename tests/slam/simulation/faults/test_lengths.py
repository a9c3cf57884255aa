from __future__ import annotations

import numpy as np
import pytest

from logs.messages import GroundTruthPose, ObjectDetections, ObjectMapRecord, Odometry, Transform
from tests.slam.simulation.faults.streams import (
    COVARIANCE,
    OBJECTS,
    T_BODY_SENSOR,
    drive,
    faulty,
    path,
    poses,
    positions,
    records,
)


def test_all_lengths_are_scaled_and_no_angle_is() -> None:
    changed = faulty("lengths_scaled=20")
    assert poses(changed)[:, :3, 3] == pytest.approx(20.0 * poses(drive())[:, :3, 3])
    assert np.array_equal(poses(changed)[:, :3, :3], poses(drive())[:, :3, :3])
    assert positions(changed) == pytest.approx(20.0 * positions(drive()))
    scan = records(changed, ObjectDetections)[0]
    assert scan.covariances is not None
    assert scan.covariances[0] == pytest.approx(400.0 * COVARIANCE)
    assert np.array_equal(scan.sizes, np.full((4, 3), 20.0))
    assert records(changed, Odometry)[0].covariance == pytest.approx(np.diag([1.0, 1.0, 1.0, 400.0, 400.0, 400.0]))
    assert records(changed, Transform)[0].T_parent_child[:3, 3] == pytest.approx(20.0 * T_BODY_SENSOR[:3, 3])
    truth = np.array([pose.T_world_body for pose in records(changed, GroundTruthPose)])
    assert truth[:, :3, 3] == pytest.approx(20.0 * path()[:, :3, 3])
    assert records(changed, ObjectMapRecord)[0].positions == pytest.approx(20.0 * OBJECTS)
