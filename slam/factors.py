"""What ties keyframes and landmarks together: records of our own, and the GTSAM factors that they become.

Everything is checked here before GTSAM sees it, since GTSAM takes a rotation that is none without a word. Noise in
GTSAM's order: rotation, then translation.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from slam.config import FactorGraphConfig
from slam.errors import FactorGraphError
from slam.geometry import FloatArray

PRIOR_SIGMA_RAD = 1e-4
PRIOR_SIGMA_M = 1e-3
# Nearer than this a bearing says nothing: the object is on top of the sensor.
MIN_RANGE_M = 0.3
ORTHONORMAL_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Holds a keyframe at ``T_map_body`` (4, 4): what fixes the map frame."""

    keyframe: int
    T_map_body: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """A between-factor: ``T_from_to`` (4, 4) with its covariance (6, 6); ``kind`` is "odometry" or "closure"."""

    from_keyframe: int
    to_keyframe: int
    T_from_to: FloatArray
    covariance: FloatArray
    kind: str


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A landmark seen from a keyframe: ``position`` (3,) m in the keyframe's body frame, covariance (3, 3) m^2.

    ``redundancy``: how many such observations carry the information of one, because they share their errors.
    """

    keyframe: int
    landmark: int
    position: FloatArray
    covariance: FloatArray
    redundancy: float = 1.0


def prior_factor(anchor: Anchor) -> gtsam.NonlinearFactor:
    """The GTSAM factor of an anchor."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([PRIOR_SIGMA_RAD, PRIOR_SIGMA_M], 3))
    return gtsam.PriorFactorPose3(
        X(anchor.keyframe), checked_pose(anchor.T_map_body, f"keyframe {anchor.keyframe}"), noise
    )


def between_factor(edge: Edge) -> gtsam.NonlinearFactor:
    """The GTSAM factor of an edge; closures are robust, odometry is not."""
    what = f"edge {edge.from_keyframe} -> {edge.to_keyframe}"
    covariance = _checked_covariance(edge.covariance, 6, what)
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(covariance)
    if edge.kind == "closure":
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(1.0), noise)
    pose = checked_pose(edge.T_from_to, what)
    return gtsam.BetweenFactorPose3(X(edge.from_keyframe), X(edge.to_keyframe), pose, noise)


def bearing_range_factor(observation: Observation, config: FactorGraphConfig) -> gtsam.NonlinearFactor:
    """The GTSAM factor of an observation, which is at least ``MIN_RANGE_M`` away."""
    what = f"observation of landmark {observation.landmark} from keyframe {observation.keyframe}"
    covariance = _checked_covariance(observation.covariance, 3, what)
    if not np.all(np.isfinite(observation.position)):
        raise FactorGraphError(f"{what}: the position {observation.position} is not finite")
    range_m = float(np.linalg.norm(observation.position))
    sight = observation.position / range_m
    range_variance = float(sight @ covariance @ sight)
    # GTSAM spans the tangent plane of the bearing by axes that jump where the smallest coordinate changes, straight
    # ahead for one. So the two bearing errors get one variance, the mean across the line of sight, and no axes.
    bearing_variance = (float(np.trace(covariance)) - range_variance) / (2.0 * range_m**2)
    variances = observation.redundancy * np.array([bearing_variance, bearing_variance, range_variance])
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Diagonal.Variances(variances)
    kernel = _robust_kernel(config, observation.redundancy)
    if kernel is not None:
        noise = gtsam.noiseModel.Robust.Create(kernel, noise)
    bearing = gtsam.Unit3(observation.position)
    return gtsam.BearingRangeFactor3D(X(observation.keyframe), L(observation.landmark), bearing, range_m, noise)


def checked_pose(T: FloatArray, what: str) -> gtsam.Pose3:
    """A rigid transform (4, 4) as GTSAM's; ``what`` it is goes into the error."""
    R = T[:3, :3]
    if not np.all(np.isfinite(T)) or np.abs(R @ R.T - np.eye(3)).max() > ORTHONORMAL_TOLERANCE or np.linalg.det(R) < 0:
        raise FactorGraphError(f"{what}: not a rigid transform: {np.array2string(T, precision=4)}")
    return gtsam.Pose3(T)


def _checked_covariance(covariance: FloatArray, size: int, what: str) -> FloatArray:
    if covariance.shape != (size, size) or not np.all(np.isfinite(covariance)):
        raise FactorGraphError(f"{what}: the covariance must be a finite {size} x {size} matrix")
    if np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise FactorGraphError(f"{what}: the covariance is not positive definite")
    return covariance


def _robust_kernel(config: FactorGraphConfig, redundancy: float) -> gtsam.noiseModel.mEstimator.Base | None:
    """The kernel of observations: its width is meant in sigmas of one observation, before redundancy widens them."""
    width = config.observation_kernel_width / np.sqrt(redundancy)
    match config.observation_kernel:
        case "cauchy":
            return gtsam.noiseModel.mEstimator.Cauchy.Create(width)
        case "huber":
            return gtsam.noiseModel.mEstimator.Huber.Create(width)
        case _:
            return None
