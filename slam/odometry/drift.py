"""The keyframes as the odometry has them: which passed near a place, and how far any two may have drifted apart."""

from collections.abc import Sequence

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import step_variances
from slam.odometry.pose import OdometryPose

_KEYFRAME = np.dtype(
    [
        ("travel_m", np.float64),
        ("segment", np.int64),
        ("position_local", np.float64, 3),
        # Over the track so far: of the translation variance of each step, and, weighted by its heading variance, of
        # one, of the horizontal position (x, y), and of its square.
        ("sums", np.float64, 5),
    ]
)


class KeyframeTrack:
    """One row a keyframe; its row is its id. ``cells``: segment, column and row of those that a keyframe is in, squares
    with sides of a sensor range.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._config = calibration.odometry
        self._cell_m = calibration.detection.sensor_range_m
        self.cells = set[tuple[float, float, float]]()
        self._rows = np.zeros(64, dtype=_KEYFRAME)
        self._size = 0
        self._latest: OdometryPose | None = None

    def add(self, keyframe: Keyframe) -> None:
        """Add the next keyframe."""
        if self._size == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        pose, position = keyframe.odometry, keyframe.T_local_body[:3, 3]
        xy_m, sums = position[:2], self._rows["sums"][self._size - 1]
        if self._latest is not None and self._latest.segment == pose.segment:
            translation, _, heading = step_variances(self._latest, pose, self._config)
            sums = sums + np.array([translation, heading, *(heading * xy_m), heading * float(xy_m @ xy_m)])
        self._rows[self._size] = pose.travel_m, pose.segment, position, sums
        self.cells.add((pose.segment, *(xy_m // self._cell_m).tolist()))
        self._latest = pose
        self._size += 1

    def replace_since(self, keyframes: Sequence[Keyframe]) -> None:
        """Replace the last keyframes by others of the same ids, which begin a segment."""
        self._size = keyframes[0].id
        self._latest = None
        for keyframe in keyframes:
            self.add(keyframe)

    def nearest(
        self, position_local: FloatArray, *, segment: int, from_m: float, to_m: float
    ) -> tuple[int, float] | None:
        """Id and distance [m] of the keyframe nearest to a place (3,) among those of a segment of the odometry and of
        that travel; None if none is.
        """
        rows = self._rows[: self._size]
        there = (rows["segment"] == segment) & (rows["travel_m"] >= from_m) & (rows["travel_m"] < to_m)
        ids = np.flatnonzero(there)
        if not len(ids):
            return None
        offsets = rows["position_local"][ids, :2] - position_local[:2]
        squares = np.einsum("ij,ij->i", offsets, offsets)
        best = np.argmin(squares)
        return int(ids[best]), float(np.sqrt(squares[best]))

    def drift_sigmas(self, first: int, last: int) -> tuple[float, float]:
        """Standard deviations of the place [m, each coordinate] and the heading [rad] of keyframe ``last`` as seen from
        ``first``, by the odometry between them; infinite across a break.

        A heading error moves all later keyframes by its lever arm, so the variance of the place is the integral of the
        squared lever arms over the heading's variance, which the running sums give for any two keyframes.
        """
        a, b = self._rows[first], self._rows[last]
        if a["segment"] != b["segment"]:
            return np.inf, np.inf
        sums, position = b["sums"] - a["sums"], b["position_local"][:2]
        translation_variance, yaw_variance, *_, square = sums.tolist()
        cross = float(position @ sums[2:4])
        levers = max(yaw_variance * float(position @ position) - 2.0 * cross + square, 0.0)
        variance = translation_variance + 0.5 * levers
        return float(np.sqrt(variance)), float(np.sqrt(yaw_variance))
