"""Vehicles that move along the tour while it is driven."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.simulation.config import TrafficConfig
from slam.simulation.drive import DrivePlan

LABEL = "vehicle"


def drive_traffic(plan: DrivePlan, at_s: FloatArray, config: TrafficConfig, *, rng: np.random.Generator) -> FloatArray:
    """Positions (K, V, 3) m of vehicles, world frame, z = 0, ``at_s`` (K,) seconds after the start.

    Each starts anywhere on the tour in either direction with its own steady speed, keeps to the right of its own
    direction by ``lane_offset_m``, and turns round at the ends of the tour.
    """
    slowest, fastest = sorted((config.min_speed_mps, config.max_speed_mps))
    speed_mps = rng.uniform(slowest, fastest, config.vehicles)
    # A round, there and back, is twice the tour: the first half of the phase goes with it, the second against.
    start_m = rng.uniform(0.0, 2.0 * plan.length_m, config.vehicles)
    phase_m = np.mod(start_m + speed_mps * at_s[:, None], 2.0 * plan.length_m)  # (K, V)
    against = phase_m > plan.length_m
    tour_m = np.where(against, 2.0 * plan.length_m - phase_m, phase_m)
    heading = np.interp(tour_m, plan.tour_m, plan.yaw_rad) + np.where(against, np.pi, 0.0)
    positions = np.zeros((*tour_m.shape, 3))
    positions[..., 0] = np.interp(tour_m, plan.tour_m, plan.xy[:, 0]) + config.lane_offset_m * np.sin(heading)
    positions[..., 1] = np.interp(tour_m, plan.tour_m, plan.xy[:, 1]) - config.lane_offset_m * np.cos(heading)
    return positions
