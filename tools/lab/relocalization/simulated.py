"""How soon a robot finds out where it is in a saved map, and whether it is right: it is kidnapped to random places.

``benchmark_relocalization`` is where to begin reading.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from logs.messages import GroundTruthPose, ObjectDetections, Odometry
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.localization.prior_map import PriorMap
from slam.self_calibration.calibration import calibrate
from slam.self_calibration.survey import survey
from slam.self_calibration.surveyed_log import SurveyedLog
from slam.simulation.config import SimulationConfig
from slam.simulation.simulation import SimulatedRecord, simulate
from slam.simulation.world import World
from slam.sweeps.workers import Death, compute_all
from tools.lab.relocalization.figures import (
    RECOVERED_WITHIN_M,
    Outcome,
    Tolerance,
    sum_up,
)
from tools.lab.relocalization.kidnaps import Kidnap, change_world, draw_kidnaps, thin_world, worsen
from tools.lab.relocalization.known_map import KnownMap, map_drive, map_of_world, truth_of
from tools.lab.relocalization.oracle import Oracle
from tools.lab.relocalization.trial import Drive, put_down

TOLERANCE = Tolerance(1.0, 3.0)
PARTS_PER_JOB = 4
"""Parts of the kidnappings that a process of its own searches, so that there is progress to report."""


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """Where the robot is kidnapped to: the map, the world as it is now, and how both are seen."""

    known: KnownMap
    world: World
    config: Config
    simulation: SimulationConfig
    first_seed: int


def benchmark_relocalization(
    world: World,
    config: Config,
    *,
    kidnaps: int,
    seed: int = 0,
    noise: float = 1.0,
    changed: float = 0.0,
    thin: float = 1.0,
    oracle: bool = False,
    max_travel_m: float = 60.0,
    jobs: int = 1,
    prior_map: PriorMap | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Map the tour of ``world`` once, then relocalize at places drawn from it.

    The same arguments give the same places, drives and verdicts for any number of ``jobs``; only times differ.

    Args:
        world: with a tour.
        config: of the estimator, for the map and for the search.
        kidnaps: how often.
        seed: of the drive that makes the map, of the places and of what changes; the drives after that follow from it.
        noise: factor on the errors of the sensor that searches.
        changed: share of the objects near the tour that are replaced after mapping.
        thin: one of so many objects of the world is left, before the map is made.
        oracle: also ask what could have been found; see :mod:`tools.lab.relocalization.oracle`.
        max_travel_m: length of each search.
        jobs: processes that search at a time.
        prior_map: in the frame of the world; instead of one that is made.
        on_progress: called with the fraction done, in [0, 1].

    Raises:
        SlamError: the world cannot be driven or mapped, or a number is out of range.
    """
    world = thin_world(world, thin, rng=np.random.default_rng([seed, 3]))
    simulation = SimulationConfig()
    worse = simulation.model_copy(update={"sensor": worsen(simulation.sensor, noise)})
    rng = np.random.default_rng([seed, 1])
    places = draw_kidnaps(world.tour, count=kidnaps, length_m=max_travel_m, rng=rng)
    now = change_world(world, changed, reach_m=simulation.sensor.max_range_m, rng=np.random.default_rng([seed, 2]))
    with threadpool_limits(1):
        config = calibrate_on_tour(world, config, simulation, seed=seed)
        known = map_of_world(prior_map) if prior_map else map_tour(world, config, simulation, seed=seed)
    outcomes, search = list[Outcome](), Search(known, now, config, worse, seed + 1)
    for outcome in search_all(search, places, jobs=jobs):
        outcomes.append(outcome)
        if on_progress is not None:
            on_progress(len(outcomes) / len(places))
    return sum_up(
        sorted(outcomes, key=lambda outcome: outcome.number),
        world=world.name,
        tour_m=world.tour_length_m,
        landmarks=known.landmark_count,
        map_ate_m=known.ate_m,
        oracle_rate=ask_oracle(search, places) if oracle else None,
    )


def calibrate_on_tour(world: World, config: Config, simulation: SimulationConfig, *, seed: int) -> Config:
    """The settings that a replay of the tour estimates; the searches are too short to estimate any."""
    if not config.calibrate:
        return config
    records = _perceived(record for _, _, record in simulate(world, simulation, seed=seed))
    return calibrate(config, survey([SurveyedLog.of(records)], config.calibration)).config


def map_tour(world: World, config: Config, simulation: SimulationConfig, *, seed: int) -> KnownMap:
    """The map that a simulated drive along the tour leaves behind.

    Raises:
        SlamError: it cannot be driven or mapped.
    """
    return map_drive(_perceived(record for _, _, record in simulate(world, simulation, seed=seed)), config)


def search_all(search: Search, kidnaps: list[Kidnap], *, jobs: int) -> Iterator[Outcome]:
    """The outcome of each kidnapping as they finish, with one job in their order.

    Raises:
        SimulationError: a process died.
    """
    parts = min(len(kidnaps), len(kidnaps) if jobs == 1 else PARTS_PER_JOB * jobs)
    tasks = [(search, kidnaps[first::parts]) for first in range(parts)]
    for _, outcomes in compute_all(_relocalize_all, tasks, jobs=jobs):
        if isinstance(outcomes, Death):
            raise SimulationError(f"a process that searched ended with {outcomes.exit_code}; try fewer jobs")
        yield from outcomes


def _relocalize_all(task: tuple[Search, list[Kidnap]]) -> list[Outcome]:
    search, kidnaps = task
    return [relocalize(search, kidnap) for kidnap in kidnaps]


def ask_oracle(search: Search, kidnaps: Sequence[Kidnap]) -> float:
    """Share of the kidnappings whose place is known for sure from all observations of the first 40 m."""
    oracle = Oracle(search.known, search.config)
    answers = [oracle.answer(_simulated(search, each), RECOVERED_WITHIN_M, TOLERANCE) for each in kidnaps]
    return float(np.mean([answer.finds(search.config.localization.error_probability) for answer in answers]))


def relocalize(search: Search, kidnap: Kidnap) -> Outcome:
    """Put the robot down, let it drive until it believes to know where it is, and 10 m more."""
    perceived = tuple(_perceived(_simulated(search, kidnap)))
    objects = _objects_in_range(search, truth_of(perceived).T_world_body[0])
    drive = Drive(kidnap.number, kidnap.start_m, kidnap.is_along, objects, perceived)
    return put_down(search.known, drive, search.config, TOLERANCE)


def _simulated(search: Search, kidnap: Kidnap) -> Iterator[SimulatedRecord]:
    """What is recorded on the drive of a kidnapping."""
    piece = replace(search.world, tour=kidnap.tour)
    return (record for _, _, record in simulate(piece, search.simulation, seed=search.first_seed + kidnap.number))


def _perceived(records: Iterable[SimulatedRecord]) -> Iterator[Odometry | ObjectDetections | GroundTruthPose]:
    return (record for record in records if isinstance(record, Odometry | ObjectDetections | GroundTruthPose))


def _objects_in_range(search: Search, T_world_body: FloatArray) -> int:
    offsets = search.world.positions[:, :2] - T_world_body[:2, 3]
    return int(np.count_nonzero(np.hypot(*offsets.T) <= search.simulation.sensor.max_range_m))
