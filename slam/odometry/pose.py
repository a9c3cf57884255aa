"""A pose on the track of the odometry."""

from dataclasses import field

import numpy as np

from logs.records import frozen
from slam.common.arrays import FloatArray


@frozen
class OdometryPose:
    """One pose on the track; ``travel_m`` is the path length up to it, ``segment`` counts the breaks before it,
    ``speed_mps`` is the speed of the step that led to it, the greatest possible where that is not known.
    ``T_odom_reported`` transforms from the frame of the messages to that of the track, which is continuous where a jump
    was corrected; ``corrected`` (3,) are the variances that all corrections so far add, of each coordinate [m^2], of
    the tilt and of the heading [rad^2].
    """

    stamp_ns: int
    T_odom_body: FloatArray
    travel_m: float
    segment: int
    speed_mps: float
    T_odom_reported: FloatArray = field(default_factory=lambda: np.eye(4))
    corrected: FloatArray = field(default_factory=lambda: np.zeros(3))
