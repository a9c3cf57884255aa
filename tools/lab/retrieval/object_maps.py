"""What descriptors give in maps of objects: by how many there are, how dense they stand and how many classes they have.

A query is what a robot has observed on a path of the travel of a submap (:mod:`tools.lab.retrieval.map_tiles`).
Nothing but descriptors and the registration of their matches proposes places.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from descriptors.constellation import gather_constellations
from descriptors.index import ConstellationIndex
from descriptors.registry import make_index
from logs.importers.maps.map_objects import MapObjects
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.registration.parameters import registration_config
from slam.registration.registration import register
from tools.lab.retrieval.map_tiles import MAP_SIGMA_M, TilesQuery, draw_path_queries
from tools.lab.retrieval.measurement import RECALL_AT, is_right

ENTERED_AT_ONCE = 50_000
"""Objects whose neighbours are in memory at the same time."""


@dataclass(frozen=True, slots=True)
class MapRecall:
    """One descriptor in one map of ``objects`` objects of ``classes`` classes, each of which has ``neighbours`` others
    within range (mean).

    ``places``: share of the ``queries`` with a right pose among the first k proposals, by k of :data:`RECALL_AT`.
    Seconds to make the index, and milliseconds of a query to match its objects and to register the matches (medians),
    all of the processor.
    """

    descriptor: str
    objects: int
    neighbours: float
    classes: int
    queries: int
    places: dict[int, float]
    index_s: float
    match_ms: float
    verify_ms: float


@dataclass(frozen=True, slots=True, eq=False)
class _ObjectMap:
    positions: FloatArray
    labels: IntArray
    vocabulary: tuple[str, ...]

    def first(self, count: int) -> _ObjectMap:
        return _ObjectMap(self.positions[:count], self.labels[:count], self.vocabulary)


def measure_recall(
    objects: MapObjects,
    descriptors: Sequence[str],
    *,
    sizes: Sequence[int],
    shares: Sequence[float] = (1.0,),
    classes: Sequence[int] = (20,),
    queries: int,
    seed: int = 0,
    on_progress: Callable[[int], None] = lambda done: None,
) -> list[MapRecall]:
    """Each descriptor in maps of the objects nearest to one of them, which is drawn; all objects are the largest map.

    The queries are drawn in the smallest map of a share and number of classes, and asked in all of these.

    Args:
        objects: in metres.
        descriptors: names, as the registry has them.
        sizes: objects of a map, before they are thinned.
        shares: of the objects that are left in a map; the others are not in the world.
        classes: how many; the commonest keep their names, all others are of one class.
        queries: in each map.
        seed: of the place, the thinning and the queries.
        on_progress: called with how many figures are done.

    Raises:
        SimulationError: objects in degrees, or so sparse that no path meets enough of them.
        DescriptorError: a descriptor that does not exist.
    """
    if objects.is_geodetic:
        raise SimulationError("objects in degrees; give metres")
    for name in descriptors:  # what cannot be made is refused before anything is measured
        make_index(name)
    rng = np.random.default_rng(seed)
    centre = objects.positions[int(rng.integers(len(objects)))]
    order = np.argsort(np.hypot(*(objects.positions[:, :2] - centre[:2]).T), kind="stable")
    asked_sizes = sorted({min(size, len(order)) for size in sizes})
    figures: list[MapRecall] = []
    with threadpool_limits(limits=1):
        for share, count in product(shares, classes):
            kept = order[rng.random(len(order)) < share]
            everything = _with_classes(objects.positions[kept], [objects.labels[row] for row in kept.tolist()], count)
            drawn: list[TilesQuery] = []
            for size in asked_sizes:
                chosen = everything.first(round(share * size))
                if not drawn:
                    names = [chosen.vocabulary[label] for label in chosen.labels.tolist()]
                    paths = np.random.default_rng((seed, 1))  # the same paths for any number of classes
                    drawn = draw_path_queries(chosen.positions, names, queries, rng=paths)
                for name in descriptors:
                    figures.append(_measure(name, chosen, drawn))
                    on_progress(len(figures))
    return figures


def _with_classes(positions: FloatArray, labels: Sequence[str], count: int) -> _ObjectMap:
    names, numbers = np.unique(labels, return_inverse=True)
    by_frequency = np.argsort(-np.bincount(numbers), kind="stable")
    merged = np.empty(len(names), dtype=np.int64)
    merged[by_frequency] = np.minimum(np.arange(len(names)), count - 1)
    return _ObjectMap(positions, merged[numbers], tuple(str(number) for number in range(min(count, len(names)))))


def _measure(descriptor: str, objects: _ObjectMap, queries: Sequence[TilesQuery]) -> MapRecall:
    index = make_index(descriptor)
    started = time.process_time()
    for start in range(0, len(objects.labels), ENTERED_AT_ONCE):
        centres = np.arange(start, min(start + ENTERED_AT_ONCE, len(objects.labels)))
        index.add(
            gather_constellations(
                objects.positions, objects.labels, objects.vocabulary, radius_m=index.radius_m, centres=centres
            )
        )
    index_s = time.process_time() - started
    hits = np.zeros(len(RECALL_AT))
    times = []
    for query in queries:
        started = time.process_time()
        poses, matched = _propose(index, objects, query)
        times.append((matched - started, time.process_time() - matched))
        right = np.flatnonzero(is_right(poses, query.T_map_query_gt[None]))
        first = int(right[0]) if len(right) else np.inf
        hits += [first < k for k in RECALL_AT]
    match_s, verify_s = np.median(times, axis=0)
    some = objects.positions[:: max(len(objects.labels) // 1000, 1), :2]
    range_m = Config().sensor_range_m
    around = cKDTree(objects.positions[:, :2]).query_ball_point(some, range_m, return_length=True)
    return MapRecall(
        descriptor=descriptor,
        objects=len(objects.labels),
        neighbours=float(np.mean(around)) - 1.0,
        classes=len(objects.vocabulary),
        queries=len(queries),
        places={k: float(share) for k, share in zip(RECALL_AT, hits / len(queries), strict=True)},
        index_s=index_s,
        match_ms=1e3 * float(match_s),
        verify_ms=1e3 * float(verify_s),
    )


def _propose(index: ConstellationIndex, objects: _ObjectMap, query: TilesQuery) -> tuple[FloatArray, float]:
    """Poses (H, 4, 4) of a query, best first, and when its objects were matched."""
    config = Config()
    submap = query.labelled_as(objects.vocabulary)
    asking = gather_constellations(submap.positions, submap.labels, objects.vocabulary, radius_m=index.radius_m)
    matches = index.search(asking, config.loop_closure.top_k, np.ones(len(index), dtype=np.bool_))
    matched = time.process_time()
    if not len(matches.queries):
        return np.zeros((0, 4, 4)), matched
    entries, references = np.unique(matches.entries, return_inverse=True)
    found = register(
        submap.positions,
        objects.positions[entries],
        np.column_stack([matches.queries, references]),
        registration_config(config),
        query_sigmas=submap.sigmas,
        reference_sigmas=np.full(len(entries), MAP_SIGMA_M),
        count=RECALL_AT[-1],
    )
    poses = [each.T_reference_query for each in found if each.T_reference_query is not None]
    return np.array(poses).reshape(-1, 4, 4), matched
