"""The prior of the robot's pose: the odometry, or anywhere in the map where the odometry has failed."""

from __future__ import annotations

import numpy as np

from logs.records import frozen
from slam.common.arrays import FloatArray
from slam.common.geometry import invert, yaw_rad

_PLANAR = (3, 4, 2)
"""x, y and yaw in a covariance (6, 6), rotation first."""


def failure_probability(failures_per_km: float, travel_m: float) -> float:
    """Probability that the odometry failed unnoticed on some travel, a metre at least."""
    return float(-np.expm1(-failures_per_km * max(travel_m, 1.0) / 1000.0))


@frozen
class PosePrior:
    """p(T) = (1 - f) N(T; T_predicted, S) + f / (2 pi A), over x, y and heading.

    ``T_local_query`` (4, 4) is the predicted pose; ``sigma_m`` and ``sigma_rad`` are the standard deviations of each
    coordinate and of the heading, infinite where the odometry predicts nothing; ``failure_probability`` is f, in
    (0, 1), and ``area_m2`` is A, the area in which the robot can be.
    """

    T_local_query: FloatArray
    sigma_m: float
    sigma_rad: float
    failure_probability: float
    area_m2: float

    def log_mass(self, T_local_query: FloatArray, covariance: FloatArray) -> float:
        """Logarithm of the prior probability of the poses that a measurement does not tell apart.

        It is the integral of p(T) exp(-d^2 / 2) over x, y and heading, where d is the Mahalanobis distance of T from
        the measured pose ``T_local_query`` (4, 4) with its ``covariance`` (6, 6), rotation first (Laplace's
        approximation of the evidence: MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28).
        """
        log_uniform = self.log_uniform(covariance)
        if np.isinf(self.sigma_m):
            return min(log_uniform, 0.0)
        planar = covariance[np.ix_(_PLANAR, _PLANAR)]
        T_residual = invert(self.T_local_query) @ T_local_query
        residual = np.array([T_residual[0, 3], T_residual[1, 3], yaw_rad(T_residual)])
        spread = planar + np.diag([self.sigma_m**2, self.sigma_m**2, self.sigma_rad**2])
        log_normal = -0.5 * float(
            residual @ np.linalg.solve(spread, residual) + np.linalg.slogdet(2.0 * np.pi * spread)[1]
        )
        followed = np.log1p(-self.failure_probability) + log_normal + log_volume(covariance)
        return min(float(np.logaddexp(followed, np.log(self.failure_probability) + log_uniform)), 0.0)

    def log_uniform(self, covariance: FloatArray) -> float:
        """The same where the robot can be anywhere in the area."""
        return float(log_volume(covariance) - np.log(2.0 * np.pi * self.area_m2))


def log_volume(covariance: FloatArray) -> float:
    """Logarithm of the integral of exp(-d^2 / 2) over x, y and heading [log m^2 rad]."""
    return 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance[np.ix_(_PLANAR, _PLANAR)])[1])
