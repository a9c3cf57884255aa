"""A contest of proposers in maps of objects: by the number, density and classes of the objects, and by the query.

A query is what a robot has observed on a path (:mod:`tools.lab.retrieval.path_queries`). Each proposer has the same
number of candidates, which are verified in the same way.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from descriptors.registry import make_index
from logs.importers.maps.map_objects import MapObjects
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.localization.localizer import log_odds_of
from slam.loop_closure.likelihood_ratio import COVERAGE_RANGES, compute_log_likelihood_ratio
from slam.object_map.submap import Submap
from slam.place_recognition.imported_places import HEIGHT_SIGMA_M
from slam.registration.parameters import registration_config
from slam.registration.registration import refine
from tools.lab.retrieval.measurement import RECALL_AT, is_right
from tools.lab.retrieval.path_queries import PathQuery, Scenario, draw_path_queries
from tools.lab.retrieval.proposers import MAP_SIGMA_M, QUADS, VOTES, LabelledObjects, Proposer, make_proposer

KEY = ["world", "proposer", "size", "share", "most_classes", "objects", "missing", "clutter", "noise_m", "queries",
       "seed"]  # fmt: skip
"""Columns that tell one cell from all others."""
GAP_M = 200.0
"""Between maps that are put side by side: no constellation has objects of two."""


@dataclass(frozen=True, slots=True)
class Contest:
    """What is measured: each proposer in maps of the objects nearest to one of them, which is drawn.

    ``sizes``: objects of a map before it is thinned to a ``share``. ``classes``: how many; the commonest keep their
    names, all others are of one class. The ``queries`` of a scenario are drawn in the smallest map of a share and a
    number of classes, and asked in all of these.
    """

    proposers: tuple[str, ...]
    sizes: tuple[int, ...]
    shares: tuple[float, ...] = (1.0,)
    classes: tuple[int, ...] = (20,)
    scenarios: tuple[Scenario, ...] = (Scenario(),)
    queries: int = 60
    seed: int = 0

    @property
    def cells(self) -> int:
        """How many figures that makes."""
        maps = len(self.sizes) * len(self.shares) * len(self.classes)
        return len(self.proposers) * maps * len(self.scenarios)


@dataclass(frozen=True, slots=True)
class Cell:
    """One proposer in one map of ``map_objects`` of ``map_classes`` classes, each with ``neighbours`` others within
    range (mean), and one scenario.

    ``at_1``, ``at_5``, ``at_25``: shares of the queries with a right pose (4 m, 10 deg) among the first proposals.
    ``right``: share with a right pose after verification, ``wrong``: share whose verified pose is accepted and wrong.
    ``propose_ms``, ``propose_p95_ms``, ``verify_ms``: of a query, median and 95th percentile. ``build_s``: to make the
    index, of ``bytes_per_object``. All times are of the processor.
    """

    world: str
    proposer: str
    size: int
    share: float
    most_classes: int
    objects: int
    missing: float
    clutter: float
    noise_m: float
    queries: int
    seed: int
    map_objects: int
    map_classes: int
    neighbours: float
    at_1: float
    at_5: float
    at_25: float
    right: float
    wrong: float
    propose_ms: float
    propose_p95_ms: float
    verify_ms: float
    bytes_per_object: float
    build_s: float


def side_by_side(maps: Sequence[MapObjects]) -> MapObjects:
    """The maps along x, one beside the other, as one.

    Raises:
        SimulationError: objects in degrees.
    """
    placed, end_m = list[FloatArray](), 0.0
    for each in maps:
        if each.is_geodetic:
            raise SimulationError(f"{each.source}: objects in degrees; give metres")
        if len(maps) == 1:
            return each
        moved = each.positions - [*each.positions[:, :2].min(axis=0), 0.0] + [end_m, 0.0, 0.0]
        end_m = float(moved[:, 0].max()) + GAP_M
        placed.append(moved)
    return MapObjects(
        " + ".join(each.source for each in maps),
        np.concatenate(placed),
        tuple(label for each in maps for label in each.labels),
        tuple(f"{number}/{name}" for number, each in enumerate(maps) for name in each.ids),
        False,
        "",
    )


def run_contest(
    objects: MapObjects,
    contest: Contest,
    *,
    results: Path | None = None,
    on_progress: Callable[[int], None] = lambda done: None,
) -> pd.DataFrame:
    """The cells of a contest, one a row with the columns of :class:`Cell`.

    Args:
        objects: in metres.
        contest: what is measured.
        results: a CSV file; cells that it has are not measured again, and each new one is added to it at once.
        on_progress: called with how many cells are done.

    Raises:
        SimulationError: objects in degrees, or so sparse that hardly any path passes enough of them.
        DescriptorError: a descriptor that does not exist.
    """
    if objects.is_geodetic:
        raise SimulationError("objects in degrees; give metres")
    for name in contest.proposers:  # what cannot be made is refused before anything is measured
        if name not in (QUADS, VOTES):
            make_index(name)
    known = read_results(results)
    measured = [known] if len(known) else []
    done = 0
    with threadpool_limits(limits=1):
        for cells in _measure(objects, contest, known):
            if len(cells):
                measured.append(cells)
                if results is not None:
                    cells.to_csv(results, mode="a", header=not results.exists(), index=False)
            done += len(contest.scenarios)
            on_progress(done)
    return _of_contest(pd.concat(measured, ignore_index=True), objects, contest)


def _measure(objects: MapObjects, contest: Contest, known: pd.DataFrame) -> Iterator[pd.DataFrame]:
    """The cells of one proposer in one map after the other, those that are not known."""
    rng = np.random.default_rng(contest.seed)
    centre = objects.positions[int(rng.integers(len(objects)))]
    order = np.argsort(np.hypot(*(objects.positions[:, :2] - centre[:2]).T), kind="stable")
    sizes = sorted({min(size, len(order)) for size in contest.sizes})
    for share, most_classes in product(contest.shares, contest.classes):
        kept = order[rng.random(len(order)) < share]
        world = _with_classes(objects.positions[kept], [objects.labels[row] for row in kept.tolist()], most_classes)
        drawn = list[list[PathQuery]]()
        for size in sizes:
            chosen = world.first(round(share * size))
            if not drawn:
                names = [chosen.vocabulary[label] for label in chosen.labels.tolist()]
                drawn = [
                    # the same paths, whatever the classes
                    draw_path_queries(
                        chosen.positions,
                        names,
                        contest.queries,
                        rng=np.random.default_rng((contest.seed, 1)),
                        scenario=scenario,
                    )
                    for scenario in contest.scenarios
                ]
            for proposer in contest.proposers:
                keys = [
                    (objects.source, proposer, size, share, most_classes, *_of_scenario(scenario), contest.queries,
                     contest.seed) for scenario in contest.scenarios
                ]  # fmt: skip
                asked = [row for row, key in enumerate(keys) if not _is_known(known, key)]
                cells = _measure_proposer(chosen, [keys[row] for row in asked], [drawn[row] for row in asked])
                yield pd.DataFrame([asdict(cell) for cell in cells])


def _measure_proposer(
    objects: LabelledObjects, keys: Sequence[tuple[object, ...]], drawn: Sequence[Sequence[PathQuery]]
) -> list[Cell]:
    """Cells of one proposer, of which ``keys`` are the values of :data:`KEY`, with the queries of each."""
    if not keys:
        return []
    started = time.process_time()
    proposer = make_proposer(str(keys[0][KEY.index("proposer")]), objects)
    build_s = time.process_time() - started
    some = objects.positions[:: max(len(objects) // 1000, 1), :2]
    tree = cKDTree(objects.positions[:, :2])
    around = tree.query_ball_point(some, Config().sensor_range_m, return_length=True)
    about_map = {
        "map_objects": len(objects),
        "map_classes": len(objects.vocabulary),
        "neighbours": float(np.mean(around)) - 1.0,
        "bytes_per_object": proposer.nbytes / len(objects),
        "build_s": build_s,
    }
    return [
        Cell(**dict(zip(KEY, key, strict=True)), **about_map, **_ask(proposer, objects, tree, queries))  # type: ignore[arg-type]
        for key, queries in zip(keys, drawn, strict=True)
    ]


def _ask(proposer: Proposer, objects: LabelledObjects, tree: cKDTree, queries: Sequence[PathQuery]) -> dict[str, float]:
    """Shares and times of a cell."""
    hits = np.zeros(len(RECALL_AT))
    right, wrong, times = 0, 0, []
    for query in queries:
        submap = query.labelled_as(objects.vocabulary)
        started = time.process_time()
        poses = proposer.propose(submap, RECALL_AT[-1])
        proposed = time.process_time()
        T_verified, is_accepted = verify(submap, poses[: Config().loop_closure.max_candidates], objects, tree)
        times.append((proposed - started, time.process_time() - proposed))
        proposals = np.flatnonzero(is_right(poses, query.T_map_query_gt[None]))
        hits += [proposals.min(initial=RECALL_AT[-1]) < k for k in RECALL_AT]
        found = T_verified is not None and bool(is_right(T_verified[None], query.T_map_query_gt[None])[0])
        right += found
        wrong += is_accepted and not found
    propose_ms, verify_ms = 1e3 * np.array(times).T
    shares = dict(zip([f"at_{k}" for k in RECALL_AT], (hits / len(queries)).tolist(), strict=True))
    return shares | {
        "right": right / len(queries),
        "wrong": wrong / len(queries),
        "propose_ms": float(np.median(propose_ms)),
        "propose_p95_ms": float(np.percentile(propose_ms, 95)),
        "verify_ms": float(np.median(verify_ms)),
    }


def verify(query: Submap, poses: FloatArray, objects: LabelledObjects, tree: cKDTree) -> tuple[FloatArray | None, bool]:
    """The pose (4, 4) with the highest log-likelihood ratio of those proposed (H, 4, 4), each registered, and whether
    its posterior probability suffices to accept it.
    """
    config = Config()
    reach_m = float(np.hypot(*query.positions[:, :2].T).max()) + COVERAGE_RANGES * config.sensor_range_m
    registering = registration_config(config.calibrated({"objects.height_sigma_m": HEIGHT_SIGMA_M}))
    best, best_llr = None, -np.inf
    for T_proposed in poses:
        near = np.sort(np.asarray(tree.query_ball_point(T_proposed[:2, 3], reach_m), dtype=np.int64))
        reference = Submap(objects.positions[near], np.full(len(near), MAP_SIGMA_M), objects.labels[near], near)
        found = refine(
            query.positions,
            query.labels,
            reference.positions,
            reference.labels,
            T_proposed,
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
    log_odds = best_llr - np.log(max(len(objects), 1))
    return best, bool(log_odds >= -log_odds_of(config.localization.error_probability))


def _with_classes(positions: FloatArray, labels: Sequence[str], count: int) -> LabelledObjects:
    names, numbers = np.unique(labels, return_inverse=True)
    by_frequency = np.argsort(-np.bincount(numbers), kind="stable")
    merged = np.empty(len(names), dtype=np.int64)
    merged[by_frequency] = np.minimum(np.arange(len(names)), count - 1)
    return LabelledObjects(positions, merged[numbers], tuple(str(number) for number in range(min(count, len(names)))))


def _of_scenario(scenario: Scenario) -> tuple[int, float, float, float]:
    """Its values in :data:`KEY`; 0 objects are all on the travel of a submap."""
    return scenario.objects or 0, scenario.missing, scenario.clutter, scenario.noise_m


def read_results(results: Path | None) -> pd.DataFrame:
    """The cells in a CSV file; none without a file."""
    if results is not None and results.exists():
        return pd.read_csv(results)
    return pd.DataFrame(columns=[field.name for field in fields(Cell)])


def _is_known(known: pd.DataFrame, key: tuple[object, ...]) -> bool:
    return bool((known[KEY] == pd.Series(key, index=KEY)).all(axis=1).any())


def _of_contest(cells: pd.DataFrame, objects: MapObjects, contest: Contest) -> pd.DataFrame:
    """The cells of this contest alone, of a file that may hold others."""
    scenarios = [_of_scenario(each) for each in contest.scenarios]
    sizes = [min(size, len(objects)) for size in contest.sizes]
    asked = (
        (cells["world"] == objects.source)
        & cells["proposer"].isin(contest.proposers)
        & cells["size"].isin(sizes)
        & cells["share"].isin(contest.shares)
        & cells["most_classes"].isin(contest.classes)
        & (cells["queries"] == contest.queries)
        & (cells["seed"] == contest.seed)
    )
    of_scenario = pd.MultiIndex.from_frame(cells[["objects", "missing", "clutter", "noise_m"]]).isin(scenarios)
    return cells[asked & of_scenario].reset_index(drop=True)
