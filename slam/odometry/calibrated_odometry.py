"""The odometry after the corrections of a calibration: stamps; lengths and turns that are wrong by a factor, as of a
wheel of another radius or track; a climb, as of a LiDAR whose beams are tilted; a drift, as by a gyroscope's bias; a
curvature, as of wheels of unequal diameter.
"""

from dataclasses import replace

import numpy as np

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw, yaw_rad


class CalibratedOdometry:
    """Corrects the messages of a drive, in their order.

    Multiplies each step by ``length_scale`` and its turn about the vertical by ``turn_scale``; raises each by ``climb``
    of its length, and turns it by ``drift_deg_per_s`` and ``curvature_deg_per_m``. Roll and pitch stay, since gravity
    gives them. A body that turns on the way goes along the chord of its arc. Poses stay in the frame of the messages.
    """

    def __init__(self, calibration: OdometryCalibration) -> None:
        self._calibration = calibration
        scales = calibration.length_scale, calibration.turn_scale
        lacking = calibration.climb, calibration.drift_deg_per_s, calibration.curvature_deg_per_m
        self._T_level = calibration.T_level_odom
        self._is_right = scales == (1.0, 1.0) and not any(lacking)
        self._offset_ns = round(calibration.time_offset_s * 1e9)
        self._latest: tuple[int, FloatArray] | None = None
        self._corrected = np.eye(4)
        self._turned_rad = 0.0

    def correct(self, odometry: Odometry) -> Odometry:
        """The next message with stamp, lengths and turns corrected; a repeated pose is repeated to the last digit."""
        if self._is_right and not self._offset_ns:
            return odometry
        T_odom_body = odometry.T_odom_body if self._is_right else self._scaled(odometry)
        return replace(odometry, stamp_ns=odometry.stamp_ns + self._offset_ns, T_odom_body=T_odom_body)

    def _scaled(self, odometry: Odometry) -> FloatArray:
        reported = self._T_level @ odometry.T_odom_body
        last_ns, last = self._latest or (0, None)
        if last is None:
            self._corrected = reported
        elif not np.array_equal(reported, last):
            step_m = reported[:3, 3] - last[:3, 3]
            turn_rad = float(yaw_rad(reported) - yaw_rad(last))
            turn_rad = (turn_rad + np.pi) % (2.0 * np.pi) - np.pi
            length_m = float(np.linalg.norm(step_m[:2]))
            lacking_deg = self._calibration.drift_deg_per_s * (odometry.stamp_ns - last_ns) * 1e-9
            lacking_deg += self._calibration.curvature_deg_per_m * length_m
            further_rad = (self._calibration.turn_scale - 1.0) * turn_rad + np.deg2rad(lacking_deg)
            on_chord = _rotation(self._turned_rad + 0.5 * further_rad)
            self._turned_rad += further_rad
            step_m[2] += self._calibration.climb * length_m
            xyz_m = self._corrected[:3, 3] + self._calibration.length_scale * (on_chord @ step_m)
            self._corrected = make_transform(_rotation(self._turned_rad) @ reported[:3, :3], xyz_m)
        self._latest = odometry.stamp_ns, reported
        return invert(self._T_level) @ self._corrected


def _rotation(yaw: float) -> FloatArray:
    """The rotation (3, 3) by a heading [rad]."""
    return transform_from_xyz_yaw(np.zeros(3), yaw)[:3, :3]
