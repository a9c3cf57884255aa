"""Apparent velocities of landmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import unit_vectors


def velocities(landmarks: NDArray[np.void], rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Velocities (N, 3) m/s in the odometry frame of some ``rows`` (N,) of the landmarks (L,), by the least-squares
    lines through all measurements, and their standard deviations (N,) m/s along them, by the noise of the measurements.
    """
    # Field by field, as whole rows are slow to copy.
    count, times = landmarks["observations"][rows], landmarks["sum_t"][rows]
    # Squared deviations [s^2] of the times of the measurements from their mean, at least (1 ms)^2.
    spreads = np.maximum(landmarks["sum_tt"][rows] - times**2 / count, 1e-6)
    slopes = landmarks["sum_tp"][rows] - times[:, None] * landmarks["sum_p"][rows] / count[:, None]
    mean = (times / count)[:, None, None]
    linear = 2.0 * landmarks["sum_tc"][rows] - mean * landmarks["sum_c"][rows]
    squares = landmarks["sum_ttc"][rows] - mean * linear
    along = unit_vectors(slopes)
    variances = np.maximum(np.einsum("ni,nij,nj->n", along, squares, along), 0.0)
    return slopes / spreads[:, None], np.sqrt(variances) / spreads
