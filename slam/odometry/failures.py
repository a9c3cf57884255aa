"""Where the heading of the odometry fails: over some way landmarks contradict it by more than its noise explains.

A gyroscope whose bias changes errs in each step by little, and by much in their sum. So the differences between the
steps of the odometry and those that landmarks corrected are summed up over windows of several lengths, as windowed
innovations are in adaptive filtering (Mehra, IEEE T-AC 1970). Positions are left out: objects that move together pull
them along, and turn nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, pairwise

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import relative, yaw_rad
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import SLIP_INFLATION, step_variances

WINDOWS = (4, 8, 16, 32, 64)
"""Steps whose differences are summed up; the corrections of fewer are mostly noise."""


def find_heading_failures(
    keyframes: Sequence[Keyframe], config: OdometryCalibration, *, failures_per_km: float
) -> dict[int, float]:
    """Factors on the heading variances of the steps that fail, by the id of the keyframe after the step.

    The heading fails in a window where the sum of the differences, by noise inflated as where closures are judged, is
    less likely than a failure on its way. The steps of the window get the factor that makes the sum one standard
    deviation.

    Args:
        keyframes: of a drive, in order; those of a prior map are passed over.
        config: the noise of the odometry.
        failures_per_km: of the odometry, beforehand.
    """
    found = dict[int, float]()
    own = [keyframe for keyframe in keyframes if not keyframe.is_prior]
    for _, group in groupby(own, key=lambda keyframe: keyframe.odometry.segment):
        members = list(group)
        factors = _factors(members, config, failures_per_km) if len(members) > WINDOWS[0] else np.zeros(0)
        found |= {members[row + 1].id: float(factors[row]) for row in np.flatnonzero(factors > 1.0).tolist()}
    return found


def _factors(keyframes: Sequence[Keyframe], config: OdometryCalibration, failures_per_km: float) -> FloatArray:
    """Factor (K - 1,) on the variance of each step between keyframes (K,) of one segment; 1 where none fails."""
    T_odom = np.array([keyframe.odometry.T_odom_body for keyframe in keyframes])
    T_local = np.array([keyframe.T_local_body for keyframe in keyframes])
    turns = yaw_rad(relative(relative(T_odom[:-1], T_odom[1:]), relative(T_local[:-1], T_local[1:])))
    poses = [keyframe.odometry for keyframe in keyframes]
    variances = np.array([step_variances(*step, config)[2] for step in pairwise(poses)])
    travel_km = 1e-3 * np.array([pose.travel_m for pose in poses])
    # A correction that errs is undone by the next one: that is noise of the headings, not of the steps.
    jitter = max(-float(np.mean(turns[1:] * turns[:-1])), 0.0)
    factors = np.ones(len(turns))
    for length in WINDOWS:
        excess = _window_sums(turns, length) ** 2 / (_window_sums(variances, length) + 2.0 * jitter)
        expected = failures_per_km * np.maximum(travel_km[length:] - travel_km[:-length], 1e-9)
        fails = excess > SLIP_INFLATION**2 * -2.0 * np.log(np.minimum(expected, 1.0))
        for start in np.flatnonzero(fails).tolist():
            steps = slice(start, start + length)
            factors[steps] = np.maximum(factors[steps], excess[start])
    return factors


def _window_sums(values: FloatArray, length: int) -> FloatArray:
    """Sums (N - length + 1,) of as many values (N,) in a row; none where there are fewer."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(sums[length:] - sums[:-length])
