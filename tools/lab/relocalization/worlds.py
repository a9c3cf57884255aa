"""How soon a robot finds out where it is in a map of a world, and whether it is right: it is kidnapped again and again.

``benchmark_relocalization`` is where to begin reading: places are drawn on a tour. In a map without a tour
(``benchmark_in_map``) the robot starts beside an object and goes straight on. Objects of open data stand along streets,
so the direction in which those around a place are spread is taken for that of the street.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from logs.messages import GroundTruthPose, ObjectDetections, Odometry
from slam.common.config import Config
from slam.common.errors import SavedMapError, SimulationError
from slam.localization.prior_map import PriorMap
from slam.place_recognition.imported_map import ImportedMap
from slam.self_calibration.calibration import calibrate
from slam.self_calibration.survey import survey
from slam.self_calibration.surveyed_log import SurveyedLog
from slam.simulation.config import SimulationConfig
from slam.simulation.simulation import SimulatedRecord, simulate
from slam.simulation.world import World
from slam.sweeps.workers import Death, compute_all
from tools.lab.relocalization.figures import sum_up
from tools.lab.relocalization.kidnaps import Kidnap, change_world, draw_kidnaps, thin_world, worsen
from tools.lab.relocalization.known_map import KnownMap, map_drive, map_of_world, truth_of
from tools.lab.relocalization.oracle import Oracle
from tools.lab.relocalization.trial import Drive, Tolerance, put_down

TOLERANCE = Tolerance(1.0, 3.0)
NEIGHBOURS = 10
"""Objects that tell the direction of a street."""
BESIDE_M = 5.0
"""How far from its row of objects the robot drives."""
CALIBRATION_M = 500.0
"""Length of a street that calibrates the robot."""


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A kidnapping: the map, the world as it is now, how both are seen, and where the robot is carried to."""

    known: KnownMap
    world: World
    config: Config
    simulation: SimulationConfig
    first_seed: int
    kidnap: Kidnap

    def records(self) -> Iterator[SimulatedRecord]:
        """What is recorded on the drive."""
        piece = replace(self.world, tour=self.kidnap.tour)
        simulated = simulate(piece, self.simulation, seed=self.first_seed + self.kidnap.number)
        return (record for _, _, record in simulated)


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
    places = draw_kidnaps(world.tour, count=kidnaps, length_m=max_travel_m, rng=np.random.default_rng([seed, 1]))
    now = change_world(world, changed, reach_m=simulation.sensor.max_range_m, rng=np.random.default_rng([seed, 2]))
    with threadpool_limits(1):
        config = calibrate_on_tour(world, config, simulation, seed=seed)
        known = map_of_world(prior_map) if prior_map else map_tour(world, config, simulation, seed=seed)
    searches = [Search(known, now, config, worse, seed + 1, place) for place in places]
    outcomes = search_all(searches, jobs=jobs, on_progress=on_progress)
    return sum_up(
        outcomes,
        world=world.name,
        tour_m=world.tour_length_m,
        landmarks=known.landmark_count,
        map_ate_m=known.ate_m,
        oracle_rate=ask_oracle(searches) if oracle else None,
    )


def benchmark_in_map(
    known: PriorMap,
    config: Config,
    *,
    kidnaps: int,
    seed: int = 0,
    noise: float = 1.0,
    changed: float = 0.0,
    max_travel_m: float = 60.0,
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Put the robot down beside objects of ``known``, drawn at random; arguments as of the benchmark on a tour.

    Raises:
        SavedMapError: the map was driven.
        SlamError: a number is out of range.
    """
    if not isinstance(known, ImportedMap):
        raise SavedMapError("the map was made by a drive, not imported; give its --objects and --trajectory")
    rng = np.random.default_rng([seed, 4])
    simulation = SimulationConfig()
    reach_m = simulation.sensor.max_range_m
    first = draw_street(known, reach_m, length_m=CALIBRATION_M, rng=rng)
    with threadpool_limits(1):
        config = calibrate_on_tour(first, config, simulation, seed=seed)
    worse = simulation.model_copy(update={"sensor": worsen(simulation.sensor, noise)})
    searches = []
    for number in range(kidnaps):
        street = draw_street(known, reach_m, length_m=max_travel_m, rng=rng)
        now = change_world(street, changed, reach_m=reach_m, rng=rng)
        kidnap = Kidnap(number, 0.0, True, now.tour)
        searches.append(Search(map_of_world(known), now, config, worse, seed + 1, kidnap))
    outcomes = search_all(searches, on_progress=on_progress)
    return sum_up(outcomes, world="streets of the map", tour_m=max_travel_m, landmarks=len(known), map_ate_m=0.0)


def draw_street(known: ImportedMap, reach_m: float, *, length_m: float, rng: np.random.Generator) -> World:
    """A straight tour beside an object, in the direction of the row that it stands in, and the objects around."""
    start = known.positions[rng.integers(len(known)), :2].astype(np.float64)
    around = known.positions_around(start[None])[:, :2]
    nearest = np.argsort(np.linalg.norm(around - start, axis=1))[:NEIGHBOURS]
    _, axes = np.linalg.eigh(np.cov(around[nearest].T))
    ahead = axes[:, -1] * rng.choice([-1.0, 1.0])
    beside = BESIDE_M * rng.choice([-1.0, 1.0]) * np.array([-ahead[1], ahead[0]])
    tour = start + beside + np.outer([0.0, length_m], ahead)
    rows = known.near(tour.mean(axis=0), 0.5 * length_m + reach_m)
    return World(
        name="a street of the map",
        object_ids=tuple(str(row) for row in rows.tolist()),
        positions=known.positions[rows].astype(np.float64),
        labels=tuple(known.vocabulary[number] for number in known.classes[rows].tolist()),
        tour=tour,
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


def search_all(
    searches: Sequence[Search], *, jobs: int = 1, on_progress: Callable[[float], None] | None = None
) -> list[dict[str, Any]]:
    """The outcome of each kidnapping, by its number.

    Raises:
        SimulationError: a process died.
    """
    outcomes = list[dict[str, Any]]()
    for _, outcome in compute_all(relocalize, searches, jobs=jobs):
        if isinstance(outcome, Death):
            raise SimulationError(f"a search process exited with code {outcome.exit_code}; try fewer jobs")
        outcomes.append(outcome)
        if on_progress is not None:
            on_progress(len(outcomes) / len(searches))
    return sorted(outcomes, key=lambda outcome: int(outcome["number"]))


def relocalize(search: Search) -> dict[str, Any]:
    """Put the robot down, let it drive until it believes to know where it is, and 10 m more."""
    perceived, kidnap = list(_perceived(search.records())), search.kidnap
    offsets = search.world.positions[:, :2] - truth_of(perceived).positions[0, :2]
    objects = int(np.count_nonzero(np.hypot(*offsets.T) <= search.simulation.sensor.max_range_m))
    drive = Drive(kidnap.number, kidnap.start_m, kidnap.is_along, objects, perceived)
    return put_down(search.known, drive, search.config, TOLERANCE)


def ask_oracle(searches: Sequence[Search]) -> float:
    """Share of the kidnappings whose place is known for sure from all observations of the first 40 m."""
    first = searches[0]
    oracle = Oracle(first.known, first.config, TOLERANCE)
    return float(np.mean([oracle.finds(search.records()) for search in searches]))


def _perceived(records: Iterable[SimulatedRecord]) -> Iterator[Odometry | ObjectDetections | GroundTruthPose]:
    return (record for record in records if isinstance(record, Odometry | ObjectDetections | GroundTruthPose))
