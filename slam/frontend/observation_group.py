"""Observations of several consecutive keyframes, combined into one observation a landmark.

The graph and its solvers take time and memory by the observation. While the odometry is far better than a detection,
observations are transformed to the frame of a later keyframe without loss, by the landmarks around, because an error of
the odometry would be common to all objects in view and not average out over them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.backend.factors import Observation
from slam.backend.observation_sums import sum_observations
from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import apply_each, relative
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import step_variances

MAX_ADDED_VARIANCE = 0.1
"""The motion between keyframes of a group adds at most that share to the variance of an observation, in the mean."""


class ObservationGroup:
    """The observations of successive keyframes of one segment, which are handed out in the frame of the last one."""

    def __init__(self, config: OdometryCalibration) -> None:
        self._config = config
        self._keyframes: list[Keyframe] = []
        self._observations: list[Observation] = []
        self._frames: list[int] = []  # of each observation, its place in ``_keyframes``
        self._variances = np.zeros(2)  # of the motion since the first keyframe: m^2 along an axis, rad^2 of the heading

    def add(self, keyframe: Keyframe, observations: Sequence[Observation]) -> None:
        """Add the observations from the next keyframe."""
        if self._keyframes:
            self._variances += self._step(keyframe)
        self._frames += [len(self._keyframes)] * len(observations)
        self._keyframes.append(keyframe)
        self._observations += observations

    def ends_before(self, keyframe: Keyframe) -> bool:
        """Whether a keyframe is of another segment, or the motion to it adds too much to the variances so far."""
        if not self._keyframes:
            return False
        if keyframe.odometry.segment != self._keyframes[-1].odometry.segment:
            return True
        if not self._observations:
            return False
        translation, heading = self._variances + self._step(keyframe)
        ranges_m = np.linalg.norm([each.position for each in self._observations], axis=1)
        variances = np.trace(_covariances(self._observations), axis1=1, axis2=2) / 3.0
        added = (translation + heading * ranges_m**2) / variances
        return bool(added.mean() > MAX_ADDED_VARIANCE)

    def take(self) -> list[Observation]:
        """The observations of the group, one a landmark, in the frame of the last keyframe; the next group begins."""
        keyframes, observations, frames = self._keyframes, self._observations, self._frames
        self._keyframes, self._observations, self._frames = [], [], []
        self._variances = np.zeros(2)
        if len(keyframes) < 2 or not observations:
            return observations
        last = keyframes[-1]
        T = np.array([relative(last.T_local_body, each.T_local_body) for each in keyframes])[frames]
        R = T[:, :3, :3]
        return sum_observations(
            np.full(len(observations), last.id),
            np.array([each.landmark for each in observations]),
            apply_each(T, np.array([each.position for each in observations])),
            R @ _covariances(observations) @ np.swapaxes(R, 1, 2),
            np.array([each.covariance_inflation for each in observations]),
        )

    def _step(self, keyframe: Keyframe) -> FloatArray:
        translation, _, heading = step_variances(self._keyframes[-1].odometry, keyframe.odometry, self._config)
        return np.array([translation, heading])


def _covariances(observations: Sequence[Observation]) -> FloatArray:
    """(N, 3, 3) m^2, inflated."""
    return np.array([each.covariance * each.covariance_inflation for each in observations])
