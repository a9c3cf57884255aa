"""The keyframes as the odometry has them: which passed near a place, and how far any two may have drifted apart."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.config import OdometryConfig
from slam.odometry.track import OdometryPose

_KEYFRAME = np.dtype(
    [
        ("travel_m", np.float64),
        ("segment", np.int64),
        ("position_odom", np.float64, 3),
        # Sums over the track so far, weighted by travel: of one, of the horizontal position, of its square.
        ("sum_one", np.float64),
        ("sum_position", np.float64, 2),
        ("sum_square", np.float64),
    ]
)


class KeyframeTrack:
    """One row a keyframe; its row is its id."""

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self._rows = np.zeros(64, dtype=_KEYFRAME)
        self._size = 0

    def add(self, pose: OdometryPose) -> None:
        """Take in the next keyframe."""
        if self._size == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        previous, row = self._rows[self._size - 1], self._rows[self._size]
        position = pose.T_odom_body[:3, 3]
        step_m = pose.travel_m - previous["travel_m"] if self._size else 0.0
        row["travel_m"], row["segment"], row["position_odom"] = pose.travel_m, pose.segment, position
        row["sum_one"] = previous["sum_one"] + step_m
        row["sum_position"] = previous["sum_position"] + step_m * position[:2]
        row["sum_square"] = previous["sum_square"] + step_m * float(position[:2] @ position[:2])
        self._size += 1

    def nearest(
        self, position_odom: FloatArray, *, segment: int, from_m: float, to_m: float
    ) -> tuple[int, float] | None:
        """Id and distance [m] of the keyframe nearest to a place (3,) among those of a segment of the odometry and of
        that travel; None if none is.
        """
        rows = self._rows[: self._size]
        first, last = np.searchsorted(rows["travel_m"], [from_m, to_m])
        first = max(first, np.searchsorted(rows["segment"], segment))
        last = min(last, np.searchsorted(rows["segment"], segment, side="right"))
        if first >= last:
            return None
        offsets = rows["position_odom"][first:last, :2] - position_odom[:2]
        squares = np.einsum("ij,ij->i", offsets, offsets)
        best = int(np.argmin(squares))
        return int(first) + best, float(np.sqrt(squares[best]))

    def drift_sigmas(self, first: int, last: int) -> tuple[float, float]:
        """Standard deviations of the place [m, each coordinate] and the heading [rad] of keyframe ``last`` as seen from
        ``first``, by the odometry between them; infinite across a break.

        A heading error moves all later keyframes by its lever arm, so the variance of the place is the integral of the
        squared lever arms over the travel, which the running sums give for any two keyframes.
        """
        a, b = self._rows[first], self._rows[last]
        if a["segment"] != b["segment"]:
            return np.inf, np.inf
        travel_m = float(b["sum_one"] - a["sum_one"])
        position = b["position_odom"][:2]
        cross = float(position @ (b["sum_position"] - a["sum_position"]))
        square = float(b["sum_square"] - a["sum_square"])
        levers = max(travel_m * float(position @ position) - 2.0 * cross + square, 0.0)
        yaw_variance = self._config.yaw_sigma**2 * travel_m
        variance = self._config.translation_sigma**2 * travel_m + 0.5 * self._config.yaw_sigma**2 * levers
        return float(np.sqrt(variance)), float(np.sqrt(yaw_variance))
