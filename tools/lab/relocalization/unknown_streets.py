"""A robot that is put down anywhere in a map without a trajectory: beside an object, from where it goes straight on.

Such a map holds no streets. Objects of open data stand along them, so the direction in which those around a place are
spread is taken for that of the street.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.localization.prior_map import PriorMap
from slam.place_recognition.imported_map import ImportedMap
from slam.simulation.config import SimulationConfig
from slam.simulation.world import World
from tools.lab.relocalization.figures import Outcome, sum_up
from tools.lab.relocalization.kidnaps import Kidnap, change_world, worsen
from tools.lab.relocalization.known_map import map_of_world
from tools.lab.relocalization.simulated import Search, calibrate_on_tour, relocalize

NEIGHBOURS = 10
"""Objects that tell the direction of a street."""
BESIDE_M = 5.0
"""How far from its row of objects the robot drives."""
CALIBRATION_M = 500.0


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
    """Put the robot down beside objects of ``known``, drawn at random.

    The arguments are those of :func:`tools.lab.relocalization.simulated.benchmark_relocalization`.

    Raises:
        SavedMapError: the map was driven.
        SlamError: a number is out of range.
    """
    if not isinstance(known, ImportedMap):
        raise SavedMapError("the map was driven, not imported; give its --objects and --trajectory")
    rng = np.random.default_rng([seed, 4])
    simulation = SimulationConfig()
    reach_m = simulation.sensor.max_range_m
    first = _street(known, reach_m, length_m=CALIBRATION_M, rng=rng)
    with threadpool_limits(1):
        config = calibrate_on_tour(first, config, simulation, seed=seed)
    worse = simulation.model_copy(update={"sensor": worsen(simulation.sensor, noise)})
    outcomes = list[Outcome]()
    for number in range(kidnaps):
        street = _street(known, reach_m, length_m=max_travel_m, rng=rng)
        now = change_world(street, changed, reach_m=reach_m, rng=rng)
        search = Search(map_of_world(known), now, config, worse, seed + 1)
        with threadpool_limits(1):
            outcomes.append(relocalize(search, Kidnap(number, 0.0, True, now.tour)))
        if on_progress is not None:
            on_progress(len(outcomes) / kidnaps)
    return sum_up(outcomes, world="streets of the map", tour_m=max_travel_m, landmarks=len(known), map_ate_m=0.0)


def _street(known: ImportedMap, reach_m: float, *, length_m: float, rng: np.random.Generator) -> World:
    """A straight tour beside an object, in the direction of the row that it stands in, and the objects around."""
    start = known.positions[rng.integers(len(known)), :2].astype(np.float64)
    around = known.positions_around(start[None])[:, :2]
    nearest = np.argsort(np.linalg.norm(around - start, axis=1))[:NEIGHBOURS]
    _, axes = np.linalg.eigh(np.cov(around[nearest].T))
    ahead = axes[:, -1] * rng.choice([-1.0, 1.0])
    beside = BESIDE_M * rng.choice([-1.0, 1.0]) * np.array([-ahead[1], ahead[0]])
    tour = start + beside + np.outer([0.0, length_m], ahead)
    rows = known.near(tour.mean(axis=0), 0.5 * length_m + reach_m)
    names = known.vocabulary
    return World(
        name="a street of the map",
        object_ids=tuple(str(row) for row in rows.tolist()),
        positions=known.positions[rows].astype(np.float64),
        labels=tuple(names[number] for number in known.classes[rows].tolist()),
        tour=tour,
    )
