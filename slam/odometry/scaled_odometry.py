"""Odometry whose lengths and turns are wrong by a factor, as of a wheel of another radius or track, or that climbs as
it goes, as that of a LiDAR whose beams are tilted: corrected.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import transform_from_xyz_yaw, yaw_rad


class ScaledOdometry:
    """Multiplies each step by ``length_scale`` and its turn about the vertical by ``turn_scale``; raises each
    by ``climb`` of its length.

    Roll and pitch stay, since gravity gives them. A body that turns on the way goes along the chord of its arc.
    """

    def __init__(self, *, length_scale: float = 1.0, turn_scale: float = 1.0, climb: float = 0.0) -> None:
        self._length_scale = length_scale
        self._turn_scale = turn_scale
        self._climb = climb
        self._reported: FloatArray | None = None
        self._corrected = np.eye(4)
        self._turned_rad = 0.0

    @classmethod
    def of(cls, calibration: OdometryCalibration) -> ScaledOdometry | None:
        """The one of a calibration; None where there is nothing to correct."""
        values = calibration.length_scale, calibration.turn_scale, calibration.climb
        if values == (1.0, 1.0, 0.0):
            return None
        return cls(length_scale=values[0], turn_scale=values[1], climb=values[2])

    def correct(self, odometry: Odometry) -> Odometry:
        """The next message with its pose corrected; a repeated pose is repeated to the last digit."""
        reported = odometry.T_odom_body
        if self._reported is None:
            self._corrected = reported
        elif not np.array_equal(reported, self._reported):
            step_m = reported[:3, 3] - self._reported[:3, 3]
            turn_rad = float(yaw_rad(reported) - yaw_rad(self._reported))
            turn_rad = (turn_rad + np.pi) % (2.0 * np.pi) - np.pi
            further_rad = (self._turn_scale - 1.0) * turn_rad
            on_chord = _rotation(self._turned_rad + 0.5 * further_rad)
            self._turned_rad += further_rad
            corrected = np.eye(4)
            corrected[:3, :3] = _rotation(self._turned_rad) @ reported[:3, :3]
            step_m[2] += self._climb * float(np.linalg.norm(step_m[:2]))
            corrected[:3, 3] = self._corrected[:3, 3] + self._length_scale * (on_chord @ step_m)
            self._corrected = corrected
        self._reported = reported
        return replace(odometry, T_odom_body=self._corrected)


def _rotation(yaw: float) -> FloatArray:
    """The rotation (3, 3) by a heading [rad]."""
    return transform_from_xyz_yaw(np.zeros(3), yaw)[:3, :3]
