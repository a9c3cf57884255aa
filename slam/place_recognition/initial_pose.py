"""The prior of the initial pose, from a user or from satellites."""

import numpy as np

from logs.records import frozen
from slam.common.arrays import FloatArray
from slam.common.errors import InputDataError
from slam.common.geometry import yaw_rad

GATE_SIGMAS = 3.5
"""A place beyond that many standard deviations is outside the prior of the pose: 2 in 1000 are, in the plane."""


@frozen
class InitialPose:
    """The robot was at ``position`` (2,) m in the map, with ``sigma_m`` of each coordinate, after ``at_travel_m`` of
    the drive; it started with the heading ``yaw_rad``, None if that is unknown.
    """

    position: FloatArray
    sigma_m: float
    yaw_rad: float | None = None
    at_travel_m: float = 0.0

    def __post_init__(self) -> None:
        """See that it is a place.

        Raises:
            InputDataError: another shape, or numbers that are not finite or positive.
        """
        numbers = np.array([*np.ravel(self.position), self.sigma_m, self.yaw_rad or 0.0], dtype=np.float64)
        if np.shape(self.position) != (2,) or not (np.isfinite(numbers).all() and self.sigma_m > 0.0):
            raise InputDataError(f"{self}: give x and y in metres, and a positive standard deviation")

    def allows(self, T_map_query: FloatArray, T_first_query: FloatArray, travel_m: float) -> bool:
        """Whether a robot that moved by ``T_first_query`` (4, 4) since the start can be at ``T_map_query`` (4, 4)."""
        reach_m = GATE_SIGMAS * self.sigma_m + abs(travel_m - self.at_travel_m)
        if np.hypot(*(T_map_query[:2, 3] - self.position)) > reach_m:
            return False
        if self.yaw_rad is None:
            return True
        off_rad = yaw_rad(T_map_query) - self.yaw_rad - yaw_rad(T_first_query)
        # The standard deviation of a heading that a person gives is that of RViz's pose estimate.
        return bool(abs(np.angle(np.exp(1j * off_rad))) <= GATE_SIGMAS * np.pi / 12.0)
