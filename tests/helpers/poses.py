"""Poses of bodies that stand upright, and keyframes there."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.geometry import make_transform, transform_from_xyz_yaw
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose


def pose_at(x: float = 0.0, y: float = 0.0, *, z: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """(4, 4), in metres and radians."""
    return transform_from_xyz_yaw(np.array([x, y, z], float), yaw)


def motion_by(rotation: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """Motions (..., 4, 4) by rotation vectors (..., 3) rad and translations (..., 3) m."""
    return make_transform(Rotation.from_rotvec(rotation).as_matrix(), np.asarray(translation))


def keyframe_at(
    T: FloatArray, number: int = 0, *, travel_m: float = 0.0, segment: int = 0, is_prior: bool = False
) -> Keyframe:
    """One a second, with the pose ``T`` (4, 4) by the odometry and among landmarks."""
    return Keyframe(number, OdometryPose(10**9 * number, T, travel_m, segment, 1.0), T, is_prior)
