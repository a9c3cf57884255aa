"""The odometry after the corrections of a calibration."""

from __future__ import annotations

from dataclasses import replace

from logs.messages import Odometry
from slam.common.calibration import OdometryCalibration
from slam.odometry.scaled_odometry import ScaledOdometry
from slam.odometry.sources import FollowedSource


class CalibratedOdometry:
    """Corrects the messages of a drive, in their order."""

    def __init__(self, calibration: OdometryCalibration) -> None:
        self._source = FollowedSource() if calibration.sources > 1 else None
        self._scaled = ScaledOdometry.of(calibration)
        self._offset_ns = round(calibration.time_offset_s * 1e9)

    def correct(self, odometry: Odometry) -> Odometry | None:
        """The next message with stamp, lengths and turns corrected; None if it is of the source that is left out."""
        if self._source is not None and not self._source.follows(odometry):
            return None
        if self._scaled is not None:
            odometry = self._scaled.correct(odometry)
        return replace(odometry, stamp_ns=odometry.stamp_ns + self._offset_ns) if self._offset_ns else odometry
