"""What is known of the robot's place before any object was recognised: a guess of a person, or a fix by GNSS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.geometry import yaw_rad

GATE_SIGMAS = 3.5
"""A place beyond that many standard deviations is not where the robot is said to be: 2 in 1000 are, in the plane."""
YAW_SIGMA_RAD = np.pi / 12.0
"""Standard deviation of a heading that a person gives; that of RViz's pose estimate."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacePrior:
    """The robot was at ``position`` (2,) m in the map, with ``sigma_m`` of each coordinate, after ``travel_m``.

    ``yaw_rad``: its heading there, None if unknown; ``odometry_yaw_rad``: what the odometry said then.
    """

    position: FloatArray
    sigma_m: float
    travel_m: float = 0.0
    yaw_rad: float | None = None
    odometry_yaw_rad: float = 0.0

    def radius_m(self, travel_m: float) -> float:
        """How far from ``position`` the robot can be after ``travel_m``."""
        return GATE_SIGMAS * self.sigma_m + abs(travel_m - self.travel_m)

    def allows(self, T_map_query: FloatArray, T_odom_query: FloatArray, travel_m: float) -> bool:
        """Whether a robot whose odometry says ``T_odom_query`` (4, 4) can be at ``T_map_query`` (4, 4)."""
        if np.hypot(*(T_map_query[:2, 3] - self.position)) > self.radius_m(travel_m):
            return False
        if self.yaw_rad is None:
            return True
        turned_rad = float(yaw_rad(T_odom_query)) - self.odometry_yaw_rad
        off_rad = float(yaw_rad(T_map_query)) - self.yaw_rad - turned_rad
        return bool(abs(np.angle(np.exp(1j * off_rad))) <= GATE_SIGMAS * YAW_SIGMA_RAD)
