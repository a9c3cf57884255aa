"""A contest of proposers in maps of objects: by the number and classes of the objects, and by the query.

A query is what a robot has observed on a path (:mod:`tools.lab.retrieval.path_queries`). Each proposer has the same
number of candidates, which are verified in the same way.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import logit
from threadpoolctl import threadpool_limits

from descriptors.baselines import RandomVector
from logs.importers.maps.map_objects import MapObjects
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.loop_closure.likelihood_ratio import COVERAGE_RANGES, compute_log_likelihood_ratios
from slam.object_map.submap import Submap
from slam.place_recognition.imported_places import HEIGHT_SIGMA_M
from slam.place_recognition.landmark_pairs import Batch, LandmarkPairs, make_landmark_pairs
from slam.place_recognition.place_search import PlaceSearch
from slam.registration.registration import register
from tools.console import progress_bar
from tools.import_logs import SURVEYED_SIGMA_M
from tools.lab.retrieval.labelled_map import RECALL_AT, LabelledMap, is_right, rank_of
from tools.lab.retrieval.path_queries import PathQuery, draw_path_queries, parse_scenario


def run_contest(
    objects: MapObjects,
    proposers: Sequence[str],
    *,
    sizes: Sequence[int],
    classes: Sequence[int],
    scenarios: Sequence[str] = ("",),
    queries: int,
    seed: int = 0,
) -> pd.DataFrame:
    """Each proposer in maps of the objects nearest to a random one, with the queries of each scenario, random vectors
    with those of the first; one a row.

    Columns: ``proposer``, ``query``, the fields of its scenario, ``map_objects``, ``map_classes``;
    ``build_s``: time to make the index, of ``bytes_per_object``. ``at_1``, ``at_5``, ``at_25``: shares of the queries
    with a right pose (4 m, 10 deg) among the first proposals. ``right``: share with a right pose after verification,
    ``wrong``: share whose verified pose is accepted and wrong. ``propose_ms``, ``propose_p95_ms``, ``verify_ms``: of a
    query, median and 95th percentile. All times are of the processor.

    Args:
        objects: in metres.
        proposers: names of descriptors.
        sizes: objects of a map.
        classes: how many; the commonest keep their names, all others are of one class.
        scenarios: texts for :func:`~tools.lab.retrieval.path_queries.parse_scenario`.
        queries: how many of a scenario; they are drawn in the smallest map, and asked in all.
        seed: of the place and of the queries.

    Raises:
        SimulationError: objects so sparse that too few paths pass enough of them.
    """
    centre = objects.positions[np.random.default_rng(seed).integers(len(objects.positions))]
    order = np.argsort(np.hypot(*(objects.positions[:, :2] - centre[:2]).T), kind="stable")
    labels = np.array(objects.labels)
    there = sorted({min(size, len(order)) for size in sizes})
    runs = list(product(classes, there, proposers))
    rows = []
    with threadpool_limits(1), progress_bar("measuring") as show_done:
        for done, (count, size, name) in enumerate(runs, start=1):
            world = _with_classes(objects.positions[order], labels[order], count)
            map_ = world.first(size)
            started = time.process_time()
            pairs, search = make_search(name, map_)
            built = {"build_s": time.process_time() - started, "bytes_per_object": pairs.nbytes / size}
            about = {"proposer": name, "map_objects": size, "map_classes": len(world.vocabulary), **built}
            for text in scenarios[: 1 if name == RandomVector.name else None]:
                scenario, rng = parse_scenario(text), np.random.default_rng((seed, 1))  # the same paths in all
                asked = draw_path_queries(world.first(there[0]), queries, scenario, rng=rng)
                figures = _measure(search, map_, asked, scenario.range_m)
                rows.append({**about, "query": text, **asdict(scenario), **figures})
            show_done(done / len(runs))
    return pd.DataFrame(rows)


def make_search(name: str, objects: LabelledMap) -> tuple[LandmarkPairs, PlaceSearch]:
    """The index of a map by a descriptor, by its name in the registry, and the search of the map with it."""
    pairs, rows = make_landmark_pairs(Config().closing(descriptor=name)), np.arange(len(objects))
    pairs.enter(Batch(objects.positions, objects.labels, rows, rows, 0, objects.vocabulary))
    return pairs, PlaceSearch(pairs, objects.positions, objects.labels, len(objects.vocabulary))


def verify(
    query: Submap, poses: FloatArray, objects: LabelledMap, tree: cKDTree, range_m: float
) -> tuple[FloatArray | None, bool]:
    """The pose (4, 4) with the highest log-likelihood ratio of those proposed (H, 4, 4), each registered, and whether
    its posterior probability suffices to accept it; ``range_m`` of the sensor.
    """
    config = Config()
    reach_m = np.hypot(*query.positions[:, :2].T).max() + COVERAGE_RANGES * range_m
    registering = config.calibrated({"objects.height_sigma_m": HEIGHT_SIGMA_M})
    best, best_llr = None, -np.inf
    for T_proposed in poses:
        near = np.sort(np.asarray(tree.query_ball_point(T_proposed[:2, 3], reach_m), dtype=np.int64))
        reference = Submap(objects.positions[near], np.full(len(near), SURVEYED_SIGMA_M), objects.labels[near], near)
        found = register(query, reference, T_proposed, registering)
        if found.T_reference_query is None:
            continue
        ratios = compute_log_likelihood_ratios(query, reference, found.T_reference_query, found.pairs, range_m)
        if ratios.sum() > best_llr:
            best, best_llr = found.T_reference_query, ratios.sum()
    log_odds = best_llr - np.log(max(len(objects), 1))
    return best, bool(log_odds >= -logit(config.localization.error_probability))


def _measure(
    search: PlaceSearch, objects: LabelledMap, queries: Sequence[PathQuery], range_m: float
) -> dict[str, float]:
    """Shares and times of a search in a map."""
    tree, rows = cKDTree(objects.positions[:, :2]), []
    for query in queries:
        truth = query.T_map_query_gt[None]
        started = time.process_time()
        poses = search.find_poses(query.submap, map_sigma_m=SURVEYED_SIGMA_M, count=RECALL_AT[-1])
        proposed = time.process_time()
        most_likely = poses[: Config().loop_closure.max_candidates]
        T_verified, is_accepted = verify(query.submap, most_likely, objects, tree, range_m)
        verified = time.process_time()
        found = T_verified is not None and bool(is_right(T_verified[None], truth)[0])
        rows.append(
            {
                "rank": rank_of(poses, truth),
                "right": found,
                "wrong": is_accepted and not found,
                "propose_ms": 1e3 * (proposed - started),
                "verify_ms": 1e3 * (verified - proposed),
            }
        )
    answers = pd.DataFrame(rows)
    return {
        **{f"at_{k}": (answers["rank"] < k).mean() for k in RECALL_AT},
        **answers[["right", "wrong"]].mean(),
        "propose_ms": answers["propose_ms"].median(),
        "propose_p95_ms": answers["propose_ms"].quantile(0.95),
        "verify_ms": answers["verify_ms"].median(),
    }


def _with_classes(positions: FloatArray, labels: NDArray[np.str_], count: int) -> LabelledMap:
    names, numbers = np.unique(labels, return_inverse=True)
    by_frequency = np.argsort(-np.bincount(numbers), kind="stable")
    merged = np.empty(len(names), dtype=np.int64)
    merged[by_frequency] = np.minimum(np.arange(len(names)), count - 1)
    return LabelledMap(positions, merged[numbers], tuple(map(str, range(min(count, len(names))))))
