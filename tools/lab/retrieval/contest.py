"""A contest of proposers in maps of objects: by the number, density and classes of the objects, and by the query.

A query is what a robot has observed on a path (:mod:`tools.lab.retrieval.path_queries`). Each proposer has the same
number of candidates, which are verified in the same way.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
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
from tools.lab.descriptors.queries import LabelledMap
from tools.lab.retrieval.measurement import RECALL_AT, is_right
from tools.lab.retrieval.path_queries import PathQuery, Scenario, draw_path_queries
from tools.lab.retrieval.proposers import MAP_SIGMA_M, QUADS, VOTES, Proposer, make_proposer

KEY = ["world", "proposer", "size", "share", "most_classes", "objects", "missing", "clutter", "noise_m", "queries",
       "seed"]  # fmt: skip
"""Columns that tell one row from all others; 0 ``objects`` are all on the travel of a submap."""
Key = tuple[object, ...]
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
    on_progress: Callable[[float], None] = lambda fraction: None,
) -> pd.DataFrame:
    """Each proposer in each map with the queries of each scenario, one a row.

    ``KEY`` has the columns that tell one from all others. ``map_objects``, ``map_classes``, ``neighbours`` (mean number
    within range of an object); ``build_s``: time to make the index, of ``bytes_per_object``. ``at_1``, ``at_5``,
    ``at_25``: shares of the queries with a right pose (4 m, 10 deg) among the first proposals. ``right``: share with a
    right pose after verification, ``wrong``: share whose verified pose is accepted and wrong. ``propose_ms``,
    ``propose_p95_ms``, ``verify_ms``: of a query, median and 95th percentile. All times are of the processor.

    Args:
        objects: in metres.
        contest: what is measured.
        results: a CSV file; rows that it has are not measured again, and each new one is added to it at once.
        on_progress: called with the fraction done, in [0, 1].

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
    before = set(known[KEY].itertuples(index=False, name=None)) if len(known) else set[Key]()
    maps = len(contest.sizes) * len(contest.shares) * len(contest.classes)
    asked, measured = list[Key](), [known] if len(known) else []
    with threadpool_limits(limits=1):
        for done, (world, proposer, queries) in enumerate(_pair(objects, contest), start=1):
            asked += queries
            new = {key: drawn for key, drawn in queries.items() if key not in before}
            if new:
                cells = _measure(world, proposer, new)
                measured.append(cells)
                if results is not None:
                    cells.to_csv(results, mode="a", header=not results.exists(), index=False)
            on_progress(done / (maps * len(contest.proposers)))
    every = pd.concat(measured, ignore_index=True)
    return every[pd.MultiIndex.from_frame(every[KEY]).isin(asked)].reset_index(drop=True)


def _pair(objects: MapObjects, contest: Contest) -> Iterator[tuple[LabelledMap, str, dict[Key, Sequence[PathQuery]]]]:
    """Each map with each proposer, and the queries of each scenario by their values of :data:`KEY`."""
    rng = np.random.default_rng(contest.seed)
    centre = objects.positions[int(rng.integers(len(objects)))]
    order = np.argsort(np.hypot(*(objects.positions[:, :2] - centre[:2]).T), kind="stable")
    sizes = sorted({min(size, len(order)) for size in contest.sizes})
    for share, most_classes in product(contest.shares, contest.classes):
        kept = order[rng.random(len(order)) < share]
        world = _with_classes(objects.positions[kept], [objects.labels[row] for row in kept.tolist()], most_classes)
        smallest = world.first(round(share * sizes[0]))
        names = [smallest.vocabulary[label] for label in smallest.labels.tolist()]
        drawn = {
            # the same paths, whatever the classes
            scenario: draw_path_queries(
                smallest.positions,
                names,
                contest.queries,
                rng=np.random.default_rng((contest.seed, 1)),
                scenario=scenario,
            )
            for scenario in contest.scenarios
        }
        for size, proposer in product(sizes, contest.proposers):
            where = (objects.source, proposer, size, share, most_classes)
            yield (
                world.first(round(share * size)),
                proposer,
                {
                    (
                        *where,
                        each.objects or 0,
                        each.missing,
                        each.clutter,
                        each.noise_m,
                        contest.queries,
                        contest.seed,
                    ): of
                    for each, of in drawn.items()
                },
            )


def _measure(objects: LabelledMap, name: str, queries: Mapping[Key, Sequence[PathQuery]]) -> pd.DataFrame:
    """A proposer in a map, with the queries of each scenario."""
    started = time.process_time()
    proposer = make_proposer(name, objects)
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
    return pd.DataFrame(
        [
            {**dict(zip(KEY, key, strict=True)), **about_map, **_ask(proposer, objects, tree, drawn)}
            for key, drawn in queries.items()
        ]
    )


def _ask(proposer: Proposer, objects: LabelledMap, tree: cKDTree, queries: Sequence[PathQuery]) -> dict[str, float]:
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


def verify(query: Submap, poses: FloatArray, objects: LabelledMap, tree: cKDTree) -> tuple[FloatArray | None, bool]:
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


def _with_classes(positions: FloatArray, labels: Sequence[str], count: int) -> LabelledMap:
    names, numbers = np.unique(labels, return_inverse=True)
    by_frequency = np.argsort(-np.bincount(numbers), kind="stable")
    merged = np.empty(len(names), dtype=np.int64)
    merged[by_frequency] = np.minimum(np.arange(len(names)), count - 1)
    return LabelledMap(positions, merged[numbers], tuple(str(number) for number in range(min(count, len(names)))))


def read_results(results: Path | None) -> pd.DataFrame:
    """The rows in a CSV file; none without a file."""
    return pd.read_csv(results) if results is not None and results.exists() else pd.DataFrame()
