"""How time and success of global localization change as the map grows, with a descriptor and without."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.simulation.world import World
from tools.lab.descriptors.experiment import hits, make_localizer
from tools.lab.descriptors.queries import SCENARIOS, LabelledMap, draw_queries, labelled_map

SIZES = (500, 1000, 2000, 4299, 10_000, 20_000, 50_000)
DRIVEN_M = 500.0
"""Queries are drawn on so much of the tour, whatever the size of the map."""
JITTER_M = 1.0
GAP_M = 100.0
STEP_M = 5.0
"""Between the points of the tour from which distances are measured."""


@dataclass(frozen=True, slots=True)
class SizeCell:
    """One method in one scenario on a map of ``objects`` objects: share of the queries within 1 m, and their time."""

    method: str
    scenario: str
    objects: int
    success: float
    median_ms: float
    p95_ms: float
    build_s: float


def benchmark_map_size(
    world: World,
    methods: Sequence[str],
    *,
    sizes: Sequence[int] = SIZES,
    queries: int,
    neighbours: int,
    seed: int = 0,
    on_progress: Callable[[int], None] = lambda done: None,
) -> list[SizeCell]:
    """The same queries in maps that grow around them, on one thread.

    The smaller maps are what is nearest to the first 500 m of the tour; the larger ones add altered copies of the world
    (:func:`grown_map`).

    Raises:
        SimulationError: a size below 1.
    """
    driven = world.shortened(DRIVEN_M).tour
    everything = labelled_map(world)
    drawn = [
        draw_queries(everything, driven, scenario, count=queries, rng=np.random.default_rng((seed, number)))
        for number, scenario in enumerate(SCENARIOS)
    ]
    cells: list[SizeCell] = []
    with threadpool_limits(limits=1):
        for size in sizes:
            objects = grown_map(everything, driven, size, rng=np.random.default_rng((seed, 99)))
            for method in methods:
                started = time.perf_counter()
                localize = make_localizer(method, objects, neighbours)
                build_s = time.perf_counter() - started
                for scenario, of_scenario in zip(SCENARIOS, drawn, strict=True):
                    times, success = [], []
                    for query in of_scenario:
                        started = time.perf_counter()
                        found = localize(query, scenario)
                        times.append(time.perf_counter() - started)
                        success.append(hits(found.T_map_query, query))
                    cells.append(
                        SizeCell(
                            method,
                            scenario.name,
                            len(objects),
                            float(np.mean(success)),
                            1e3 * float(np.median(times)),
                            1e3 * float(np.percentile(times, 95)),
                            build_s,
                        )
                    )
                    on_progress(len(cells))
    return cells


def grown_map(objects: LabelledMap, tour: FloatArray, size: int, *, rng: np.random.Generator) -> LabelledMap:
    """The ``size`` objects nearest to the ``tour`` (M, 2); where there are too few, altered copies of all are added.

    Copies stand side by side, each turned by any angle, mirrored or not, and every object moved by about a metre, so
    that none repeats another.

    Raises:
        SimulationError: a size below 1.
    """
    if size < 1:
        raise SimulationError(f"a map of {size} objects; give at least 1")
    place = objects.positions[:, :2]
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tour, axis=0), axis=1)))
    every_m = np.append(np.arange(0.0, along_m[-1], STEP_M), along_m[-1])
    points = np.column_stack([np.interp(every_m, along_m, tour[:, axis]) for axis in (0, 1)])
    distances_m = cKDTree(points).query(place)[0]
    nearest = np.argsort(distances_m, kind="stable")
    if size <= len(objects):
        chosen = np.sort(nearest[:size])
        return LabelledMap(objects.positions[chosen], objects.labels[chosen], objects.vocabulary)
    positions, labels = [objects.positions], [objects.labels]
    middle = 0.5 * (place.min(axis=0) + place.max(axis=0))
    pitch_m = 2.0 * float(np.linalg.norm(place - middle, axis=1).max()) + GAP_M
    copies = int(np.ceil(size / len(objects))) - 1
    side = int(np.ceil(np.sqrt(copies + 1)))
    for copy in range(1, copies + 1):
        angle, mirror = rng.uniform(-np.pi, np.pi), rng.choice([-1.0, 1.0])
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        moved = objects.positions.copy()
        moved[:, :2] = ((place - middle) * [1.0, mirror]) @ turn.T + middle
        moved[:, :2] += rng.normal(0.0, JITTER_M, place.shape) + pitch_m * np.array(divmod(copy, side))
        positions.append(moved)
        labels.append(objects.labels)
    return LabelledMap(np.concatenate(positions)[:size], np.concatenate(labels)[:size], objects.vocabulary)
