"""A kidnapped robot in maps of tiles of any size: what they take to make, to open and to query.

A query is what a robot has observed on a straight path of the travel of a submap: objects within range of it, some of
them missed, some that no map has, and positions with noise. The same queries are asked in a map of the objects around
them and in the whole, and of the exhaustive search over all pairs.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from logs.importers.maps.map_objects import MapObjects
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.localization.localizer import log_odds_of
from slam.loop_closure.likelihood_ratio import COVERAGE_RANGES, compute_log_likelihood_ratio
from slam.object_map.submap import SUBMAP_RANGES, Submap
from slam.place_recognition.imported_map import ImportedMap, load_imported_map, make_imported_map, save_imported_map
from slam.place_recognition.imported_places import HEIGHT_SIGMA_M
from slam.registration.parameters import registration_config
from slam.registration.registration import refine
from slam.sweeps.workers import Death, compute_all
from tools.lab.retrieval.exhaustive_search import make_exhaustive_search

TILES, EXHAUSTIVE = "tiles", "exhaustive search"
MAP_SIGMA_M, QUERY_SIGMA_M = 0.3, 0.2
"""Standard deviations of a coordinate in the map and in the query."""
MISSED, CLUTTER = 0.1, 0.1
"""Shares of the objects of a query that it misses, and that the map does not have."""
MIN_OBJECTS = 8
"""A path with fewer objects is no query."""
RIGHT_M = 2.0
"""A pose is right within that distance of the true one."""
SEARCHED_PAIR_M = 60.0
"""Longest pairs of objects of the exhaustive search: the diameter of what a sensor sees."""
EXHAUSTIVE_QUERIES = 10
"""So many are asked of the exhaustive search, which takes seconds each."""


@dataclass(frozen=True, slots=True)
class TilesCell:
    """One method in one map. ``make_s``, ``make_mb``: time and memory to make the map and its file, of ``file_mb``;
    ``open_s``: to open it; ``success``: share of the ``queries`` whose best pose is right, ``accepted_wrong`` share of
    those accepted that are not; times of a query. All times are of the processor, which is shared with nobody then; NaN
    where the memory did not suffice.
    """

    method: str
    objects: int
    make_s: float
    make_mb: float
    file_mb: float
    open_s: float
    queries: int
    success: float
    accepted_wrong: float
    median_ms: float
    p95_ms: float


@dataclass(frozen=True, slots=True, eq=False)
class TilesQuery:
    """``submap`` in the frame of the robot, labels as in ``vocabulary``, and where it is, ``T_map_query_gt`` (4, 4)."""

    submap: Submap
    vocabulary: tuple[str, ...]
    T_map_query_gt: FloatArray

    def labelled_as(self, vocabulary: Sequence[str]) -> Submap:
        """The submap with labels as in another vocabulary, which has all classes of this one."""
        number = {name: place for place, name in enumerate(vocabulary)}
        labels = np.array([number[name] for name in self.vocabulary], dtype=np.int64)[self.submap.labels]
        return replace(self.submap, labels=labels)


@dataclass(frozen=True, slots=True, eq=False)
class _Making:
    positions: FloatArray
    labels: tuple[str, ...]
    path: Path


def benchmark_tiles(
    objects: MapObjects,
    sizes: Sequence[int],
    *,
    queries: int,
    seed: int = 0,
    on_progress: Callable[[int], None] = lambda done: None,
) -> list[TilesCell]:
    """Both methods in maps of the objects nearest to one of them, which is drawn; all objects are the largest.

    Raises:
        SimulationError: objects in degrees, or so sparse that no path meets enough of them.
        SavedMapError: positions of which no map can be made.
    """
    if objects.is_geodetic:
        raise SimulationError("objects in degrees; give metres")
    rng = np.random.default_rng(seed)
    centre = objects.positions[int(rng.integers(len(objects.labels)))]
    order = np.argsort(np.hypot(*(objects.positions[:, :2] - centre[:2]).T), kind="stable")
    asked = sorted({min(size, len(order)) for size in sizes})
    cells: list[TilesCell] = []
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(limits=1):
        drawn: list[TilesQuery] = []
        for size in asked:
            rows = np.sort(order[:size])
            labels = tuple(objects.labels[row] for row in rows.tolist())
            if not drawn:
                drawn = draw_path_queries(objects.positions[rows], labels, queries, rng=rng)
            path = Path(folder) / f"{size}.mcap"
            make_s, make_mb = _made(_Making(objects.positions[rows], labels, path))
            started = time.process_time()
            imported = load_imported_map(path)
            open_s = time.process_time() - started
            for method, chosen in ((TILES, drawn), (EXHAUSTIVE, drawn[:EXHAUSTIVE_QUERIES])):
                answers = _answers(method, imported, chosen)
                wrong = sum(each.is_accepted and not each.is_right for each in answers)
                times_ms = [1e3 * each.seconds for each in answers]
                cells.append(
                    TilesCell(
                        method,
                        size,
                        make_s,
                        make_mb,
                        path.stat().st_size / 1e6,
                        open_s,
                        len(answers),
                        float(np.mean([each.is_right for each in answers])) if answers else float("nan"),
                        wrong / max(sum(each.is_accepted for each in answers), 1),
                        float(np.median(times_ms)) if answers else float("nan"),
                        float(np.percentile(times_ms, 95)) if answers else float("nan"),
                    )
                )
                on_progress(len(cells))
    return cells


@dataclass(frozen=True, slots=True)
class _Answer:
    is_right: bool
    is_accepted: bool
    seconds: float


def _answers(method: str, imported: ImportedMap, queries: Sequence[TilesQuery]) -> list[_Answer]:
    """What a method makes of queries; nothing where the memory does not suffice for it."""
    try:
        if method == TILES:
            return [_timed(query, imported, lambda submap: locate(imported, submap, Config())) for query in queries]
        search = _exhaustive(imported)
        return [_timed(query, imported, search) for query in queries]
    except MemoryError:
        return []


def _timed(
    query: TilesQuery, imported: ImportedMap, answer: Callable[[Submap], tuple[FloatArray | None, bool]]
) -> _Answer:
    submap = query.labelled_as(imported.vocabulary)
    started = time.process_time()
    T, is_accepted = answer(submap)
    seconds = time.process_time() - started
    is_right = T is not None and bool(np.linalg.norm((T - query.T_map_query_gt)[:2, 3]) < RIGHT_M)
    return _Answer(is_right, is_accepted, seconds)


def draw_path_queries(
    positions: FloatArray, labels: Sequence[str], count: int, *, rng: np.random.Generator
) -> list[TilesQuery]:
    """Queries from straight paths that begin at objects of the map, in any direction.

    Raises:
        SimulationError: objects so sparse that no path meets enough of them.
    """
    config = Config()
    travel_m, range_m = SUBMAP_RANGES * config.sensor_range_m, config.sensor_range_m
    tree = cKDTree(positions[:, :2])
    names = {name: number for number, name in enumerate(sorted(set(labels)))}
    classes = np.array([names[label] for label in labels], dtype=np.int64)
    drawn: list[TilesQuery] = []
    for _ in range(100 * count):
        if len(drawn) == count:
            return drawn
        begin, yaw = positions[int(rng.integers(len(positions)))], rng.uniform(-np.pi, np.pi)
        steps = np.arange(0.0, travel_m + 1.0, 5.0)[:, None] * np.array([np.cos(yaw), np.sin(yaw)])
        near = tree.query_ball_point(begin[:2] + steps, range_m)
        seen = np.unique(np.concatenate([np.asarray(rows, dtype=np.int64) for rows in near]))
        seen = seen[rng.random(len(seen)) >= MISSED]
        if len(seen) < MIN_OBJECTS:
            continue
        end = np.array([*(begin[:2] + steps[-1]), float(np.median(positions[seen, 2]))])
        drawn.append(_observed(positions[seen], classes[seen], transform_from_xyz_yaw(end, yaw), tuple(names), rng))
    raise SimulationError(
        f"paths of {travel_m:g} m rarely meet {MIN_OBJECTS} objects within {range_m:g} m; give a denser map"
    )


def _observed(
    positions: FloatArray,
    classes: IntArray,
    T_map_query: FloatArray,
    vocabulary: tuple[str, ...],
    rng: np.random.Generator,
) -> TilesQuery:
    local = apply(invert(T_map_query), positions)
    invented = rng.choice(len(local), int(rng.binomial(len(local), CLUTTER)), replace=False)
    local[invented, :2] = rng.uniform(local[:, :2].min(axis=0), local[:, :2].max(axis=0), (len(invented), 2))
    local[:, :2] += rng.normal(0.0, QUERY_SIGMA_M, (len(local), 2))
    sigmas = np.full(len(local), QUERY_SIGMA_M)
    return TilesQuery(Submap(local, sigmas, classes, np.arange(len(local))), vocabulary, T_map_query)


def locate(imported: ImportedMap, query: Submap, config: Config) -> tuple[FloatArray | None, bool]:
    """The pose (4, 4) of a query with the highest log-likelihood ratio, and whether that suffices to accept it."""
    sigma_m = float(np.hypot(np.median(query.sigmas), imported.sigma_m))
    poses = imported.quads.find_poses(
        query.positions,
        query.labels,
        imported.positions,
        sigma_m=sigma_m,
        count=config.loop_closure.max_candidates,
    )
    reach_m = float(np.hypot(*query.positions[:, :2].T).max()) + COVERAGE_RANGES * config.sensor_range_m
    registering = registration_config(config.calibrated({"objects.height_sigma_m": HEIGHT_SIGMA_M}))
    best, best_llr = None, -np.inf
    for T_voted in poses:
        near = imported.near(T_voted[:2, 3], reach_m)
        reference = Submap(
            imported.positions[near].astype(np.float64),
            np.full(len(near), imported.sigma_m),
            imported.classes[near].astype(np.int64),
            near,
        )
        found = refine(
            query.positions,
            query.labels,
            reference.positions,
            reference.labels,
            T_voted,
            registering,
            query_sigmas=query.sigmas,
            reference_sigmas=reference.sigmas,
        )
        if found.T_reference_query is None:
            continue
        ratio = compute_log_likelihood_ratio(
            query, reference, found.T_reference_query, found.pairs, config.sensor_range_m
        )
        if ratio.total > best_llr:
            best, best_llr = found.T_reference_query, ratio.total
    log_odds = best_llr - np.log(len(imported))
    return best, bool(log_odds >= -log_odds_of(config.localization.error_probability))


def _exhaustive(imported: ImportedMap) -> Callable[[Submap], tuple[FloatArray | None, bool]]:
    config = registration_config(Config().calibrated({"objects.height_sigma_m": HEIGHT_SIGMA_M}))
    search = make_exhaustive_search(
        imported.positions.astype(np.float64),
        imported.classes.astype(np.int64),
        np.full(len(imported), imported.sigma_m),
        config,
        reach_m=SEARCHED_PAIR_M,
    )

    def answer(query: Submap) -> tuple[FloatArray | None, bool]:
        found = search.localize(query.positions, query.labels, sigmas=query.sigmas)
        return found[0].T_reference_query, False

    return answer


def _made(making: _Making) -> tuple[float, float]:
    """Seconds and MB that a fresh process takes to make a map."""
    ((_, outcome),) = compute_all(_make, [making], jobs=1, fresh=True)
    if isinstance(outcome, Death):
        raise SimulationError(f"the process that made a map of {len(making.labels)} objects died; give it more memory")
    return outcome


def _make(making: _Making) -> tuple[float, float]:
    started = time.process_time()
    ids = [str(row) for row in range(len(making.labels))]
    save_imported_map(making.path, make_imported_map(making.positions, making.labels, ids, sigma_m=MAP_SIGMA_M))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return time.process_time() - started, peak / (1e6 if sys.platform == "darwin" else 1e3)
