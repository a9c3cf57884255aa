"""Time until a mapping robot detects a kidnapping that its odometry does not show.

``benchmark_silent_kidnapping`` is where to begin reading.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from logs.messages import GroundTruthPose, ObjectDetections, Odometry
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.evaluation.metrics.statistics import percentile
from slam.simulation.config import KidnapConfig, SimulationConfig
from slam.simulation.simulation import simulate
from slam.simulation.world import World
from slam.system import Slam

NOTICED_WITHIN_M = 30.0
"""Travel within which a kidnapping counts as noticed."""
BEFORE_M, AFTER_M = 150.0, 60.0
"""What is driven before the kidnapping and after it."""
MIN_DISTANCE_M = 100.0
"""How far away the robot is carried at least."""


def benchmark_silent_kidnapping(
    world: World,
    config: Config,
    *,
    kidnaps: int,
    seed: int = 0,
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Carry a robot off again and again while it makes a map; each drive is a short one of its own.

    ``noticed_rate``: share noticed within 30 m; ``median_m``: travel until it is, None if none was; ``false_alarms``:
    kidnappings noticed before the first one. Of each of the ``kidnappings`` the places on the tour [m], the travel
    ``noticed_m`` until it was noticed, None if it was not, and the false alarms.

    Args:
        world: with a tour.
        config: of the estimator.
        kidnaps: how often.
        seed: of the places and of the drives.
        on_progress: called with the fraction done, in [0, 1].

    Raises:
        SimulationError: the tour is too short.
    """
    length_m = world.tour_length_m
    if length_m < BEFORE_M + AFTER_M + 2.0 * MIN_DISTANCE_M:
        raise SimulationError(
            f"a tour of {length_m:.0f} m; give one of at least {BEFORE_M + AFTER_M + 2.0 * MIN_DISTANCE_M:.0f} m"
        )
    rng = np.random.default_rng([seed, 4])
    done = list[dict[str, Any]]()
    with threadpool_limits(1):
        for number in range(kidnaps):
            from_m = to_m = float(rng.uniform(BEFORE_M, length_m - AFTER_M))
            while abs(to_m - from_m) < MIN_DISTANCE_M:
                to_m = float(rng.uniform(0.0, length_m - AFTER_M))
            noticed_m, false_alarms = _carry_off(world, config, from_m, to_m, seed=seed + number)
            done.append({"from_m": from_m, "to_m": to_m, "noticed_m": noticed_m, "false_alarms": false_alarms})
            if on_progress is not None:
                on_progress(len(done) / kidnaps)
    noticed = [each["noticed_m"] for each in done]
    return {
        "world": world.name,
        "noticed_rate": sum(each is not None and each <= NOTICED_WITHIN_M for each in noticed) / kidnaps,
        "median_m": percentile(noticed, 50.0),
        "false_alarms": sum(each["false_alarms"] for each in done),
        "kidnappings": done,
    }


def _carry_off(world: World, config: Config, from_m: float, to_m: float, *, seed: int) -> tuple[float | None, int]:
    """Travel [m] from the kidnapping until it is noticed, None if it is not; and kidnappings noticed before."""
    kidnap = KidnapConfig(from_m=from_m, to_m=to_m, silent=True, before_m=BEFORE_M, after_m=AFTER_M)
    simulation = SimulationConfig(kidnap=kidnap)
    longest_step_m = 2.0 * simulation.drive.speed_mps / simulation.drive.rate_hz
    slam, false_alarms = Slam(config), 0
    position, since_m = None, None
    for _, _, record in simulate(world, simulation, seed=seed):
        if isinstance(record, GroundTruthPose):
            step_m = 0.0 if position is None else float(np.linalg.norm(record.T_world_body[:2, 3] - position))
            position = record.T_world_body[:2, 3]
            if since_m is not None:
                since_m += step_m
            elif step_m > longest_step_m:
                since_m, false_alarms = 0.0, slam.counters["kidnappings_detected"]
        elif isinstance(record, Odometry | ObjectDetections):
            slam.process(record)
            if since_m is not None and slam.counters["kidnappings_detected"] > false_alarms:
                return since_m, false_alarms
    return None, false_alarms
