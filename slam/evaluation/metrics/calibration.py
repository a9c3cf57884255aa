"""Whether the covariances of a map are right: errors measured by the covariance that the map gives them.

The normalised estimation error squared (NEES) of an error e with the covariance P is ``e^T P^-1 e``. If P is right and
the errors are normal, it has the chi-squared distribution of the dimension of e (Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, 2001, section 5.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import gammaincinv

from slam.common.arrays import FloatArray
from slam.common.geometry import invert

IN_PLANE = (2, 3, 4)
"""Heading, x and y among the six of a pose."""


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """N errors with their covariances: squares (N,) is the NEES of each, ``dimension`` its degrees of freedom.

    ``unusable_count``: errors that were left out, because their covariance is none.
    """

    squares: FloatArray
    dimension: int
    unusable_count: int = 0

    @property
    def count(self) -> int:
        """Number of errors."""
        return len(self.squares)

    @property
    def nees(self) -> float:
        """Mean NEES of a degree of freedom: 1 is right, more is overconfident, less is too careful."""
        return float(np.mean(self.squares)) / self.dimension

    def coverage(self, probability: float) -> float:
        """Share of the errors in the region that holds them with ``probability`` if the covariances are right."""
        return float(np.mean(self.squares <= 2.0 * gammaincinv(0.5 * self.dimension, probability)))


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationQuality:
    """NEES of what a map holds; None where there is zeros to measure. ``planar_``: the same in the plane.

    ``probability``: that of the regions whose coverage is counted.
    """

    probability: float
    pose: Consistency | None
    planar_pose: Consistency | None
    landmark: Consistency | None
    planar_landmark: Consistency | None
    closure: Consistency | None
    planar_closure: Consistency | None


def measure_consistency(errors: FloatArray, covariances: FloatArray) -> Consistency | None:
    """Set errors (N, D) against covariances (N, D, D); None where no covariance is one (N may be 0)."""
    dimension = errors.shape[1]
    finite = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(errors).all(axis=1)
    usable = np.zeros(len(errors), dtype=np.bool_)
    usable[finite] = np.linalg.eigvalsh(covariances[finite])[:, 0] > 0.0
    if not usable.any():
        return None
    whitened = np.linalg.solve(covariances[usable], errors[usable][:, :, None])[:, :, 0]
    squares = np.einsum("ni,ni->n", errors[usable], whitened)
    return Consistency(squares, dimension, int(np.count_nonzero(~usable)))


def measure_part(errors: FloatArray, covariances: FloatArray, axes: tuple[int, ...]) -> Consistency | None:
    """The same of some ``axes`` alone, by the marginal covariances of these."""
    chosen = list(axes)
    return measure_consistency(errors[:, chosen], covariances[:, chosen][:, :, chosen])


def pose_errors(T_est: FloatArray, T_gt: FloatArray) -> FloatArray:
    """Errors (N, 6) of poses (N, 4, 4), rotation [rad] first: ``T_gt = T_est Exp(error)``, about the axes of the body.

    It is what the covariances of poses and closures are about.
    """
    return _logarithm(invert(T_est) @ T_gt)


def tie(T_map_body_est: FloatArray, T_world_body_gt: FloatArray) -> FloatArray:
    """``T_world_map`` (4, 4) that lays one estimated pose on its truth; both (4, 4)."""
    return np.asarray(T_world_body_gt @ invert(T_map_body_est))


def _logarithm(T: FloatArray) -> FloatArray:
    """The tangent vector (N, 6), rotation first, of transforms (N, 4, 4); the inverse of GTSAM's ``Pose3.Expmap``."""
    rotation = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    angle = np.linalg.norm(rotation, axis=1)
    x, y, z = rotation.T
    zeros = np.zeros(len(T))
    skew = np.stack([zeros, -z, y, z, zeros, -x, -y, x, zeros], axis=1).reshape(-1, 3, 3)
    is_small = angle < 1e-4
    safe = np.where(is_small, 1.0, angle)
    # 1 / a^2 - cot(a / 2) / (2 a), which is 1 / 12 at 0.
    factor = np.where(is_small, 1.0 / 12.0, 1.0 / safe**2 - 0.5 / (safe * np.tan(0.5 * safe)))
    to_tangent = np.eye(3) - 0.5 * skew + factor[:, None, None] * (skew @ skew)
    return np.concatenate([rotation, np.einsum("nij,nj->ni", to_tangent, T[:, :3, 3])], axis=1)
