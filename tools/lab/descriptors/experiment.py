"""Localization of single scans with each descriptor, by the experiment of the Descriptellation paper (Section IV).

Verification and acceptance are those of :class:`slam.scan_localization.ScanLocalizer`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from descriptors.constellation import Constellations, gather_constellations
from descriptors.index import ConstellationIndex
from descriptors.registry import make_index
from logs.messages import ObjectDetections
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.loop_closure.candidate import Candidate, Query
from slam.place_recognition.imported_places import SEGMENT, TRAVEL_M
from slam.place_recognition.place import Place
from slam.registration.parameters import registration_config
from slam.scan_localization import ScanLocalizer, Verified
from tools.lab.descriptors.queries import SCENARIOS, LabelledMap, LocalQuery, Scenario, draw_queries
from tools.lab.retrieval.exhaustive_search import ExhaustiveSearch, make_exhaustive_search

EXHAUSTIVE = "exhaustive search"
"""The reference without a descriptor."""
SEARCHED_PAIR_M = 60.0
"""Longest pairs of objects of the exhaustive search: the diameter of what a sensor sees."""

SUCCESS_M = 1.0
MISPLACED_M = 10.0
TOP = 5
MAP_SIGMA_M = 0.05
NOISE_PER_M = 0.08
"""Of a noisy query's positions by range, along any axis: 0.1 / sqrt(3) from its error, and as much from the scale."""


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a method found for a query: the accepted pose ``T_map_query`` and that of the likeliest candidate, (4, 4) or
    None; and the time that it took, in seconds.
    """

    T_map_query: FloatArray | None
    T_map_likeliest: FloatArray | None
    seconds: float


Localizer = Callable[[LocalQuery, Scenario], Answer]
"""Finds a query, whose noise is that of the scenario."""


def benchmark_descriptors(
    objects: LabelledMap,
    tour: FloatArray,
    methods: Sequence[str],
    *,
    neighbours: int,
    queries: int,
    seeds: int,
    on_progress: Callable[[float], None] = lambda fraction: None,
) -> pd.DataFrame:
    """Every method on the same queries, on one thread.

    Args:
        objects: the map.
        tour: (M, 2) m, where queries are drawn.
        methods: names of descriptors, or :data:`EXHAUSTIVE`.
        neighbours: nearest descriptors of each object that retrieval takes.
        queries: for each scenario and seed.
        seeds: 0 to ``seeds`` - 1.
        on_progress: called with the fraction done, in [0, 1].

    Returns:
        A row for each ``method`` and ``scenario``. ``success`` and ``deviation`` over the seeds: shares of the queries
        that are accepted within 1 m. ``of_ceiling``: that success by the ``ceiling``, the one with true
        correspondences; None if that is 0. ``misplaced``: share that is accepted farther than 10 m off. ``likeliest``:
        share whose likeliest candidate is within 1 m, accepted or not. ``top_5``: share of the objects seen whose
        counterpart is among their 5 nearest descriptors, None without a descriptor. ``query_ms``: median.
        ``build_s``: to index the map.

    Raises:
        DescriptorError: a descriptor that does not exist, or that the map's classes are too many for.
        SimulationError: nothing to measure, a tour without length, or without an object in sight.
    """
    if queries < 1 or seeds < 1:
        raise SimulationError(f"{queries} queries and {seeds} seeds; give at least one of each")
    for method in methods:  # what cannot be made is refused before anything is measured
        if method != EXHAUSTIVE:
            make_index(method)
    drawn = {
        scenario.name: [
            draw_queries(objects, tour, scenario, count=queries, rng=np.random.default_rng((seed, number)))
            for seed in range(seeds)
        ]
        for number, scenario in enumerate(SCENARIOS)
    }
    cells: list[dict[str, Any]] = []
    with threadpool_limits(limits=1):
        for method in methods:
            started = time.perf_counter()
            localize = make_localizer(method, objects, neighbours)
            build_s = time.perf_counter() - started
            for scenario in SCENARIOS:
                figures = _measure(method, localize, objects, scenario, drawn[scenario.name])
                cells.append({"method": method, "scenario": scenario.name, **figures, "build_s": build_s})
                on_progress(len(cells) / (len(methods) * len(SCENARIOS)))
    return pd.DataFrame(cells, dtype=object)


def make_localizer(method: str, objects: LabelledMap, neighbours: int) -> Localizer:
    """Take in a map for one method: a descriptor's name, or :data:`EXHAUSTIVE`."""
    record = objects.to_record()
    configs = {noisy: localizer_config(method, neighbours, noisy=noisy) for noisy in (False, True)}
    localizers = {noisy: ScanLocalizer(record, config) for noisy, config in configs.items()}
    proposers = {noisy: localizer.propose for noisy, localizer in localizers.items()}
    if method == EXHAUSTIVE:
        proposers = {
            noisy: partial(_search, localizers[noisy], _make_search(objects, config))
            for noisy, config in configs.items()
        }

    def localize(query: LocalQuery, scenario: Scenario) -> Answer:
        localizer = localizers[scenario.noisy]
        scan = ObjectDetections(0, "scan", query.positions, objects.names(query.labels), np.ones(len(query)))
        return _answer(localizer, localizer.query(scan), proposers[scenario.noisy])

    return localize


def _make_search(objects: LabelledMap, config: Config) -> ExhaustiveSearch:
    sigmas = np.full(len(objects), config.calibration.objects.landmark_sigma_m)
    return make_exhaustive_search(
        objects.positions, objects.labels, sigmas, registration_config(config), reach_m=SEARCHED_PAIR_M
    )


def _search(localizer: ScanLocalizer, search: ExhaustiveSearch, query: Query) -> list[Verified]:
    submap = query.submap
    found = search.localize(submap.positions, submap.labels, sigmas=submap.sigmas)
    poses = [each.T_reference_query for each in found if each.T_reference_query is not None]
    return localizer.verify(query, [Place(T, TRAVEL_M, SEGMENT, np.inf, EXHAUSTIVE) for T in poses[:TOP]])


def _answer(localizer: ScanLocalizer, query: Query, propose: Callable[[Query], list[Verified]]) -> Answer:
    started = time.perf_counter()
    if not localizer.has_enough_objects(query):
        return Answer(None, None, time.perf_counter() - started)
    verified = propose(query)
    accepted = localizer.decide(query, verified).accepted
    seconds = time.perf_counter() - started
    candidates = [each for each in verified if isinstance(each, Candidate)]
    return Answer(_pose(accepted), _pose(max(candidates, key=lambda each: each.score, default=None)), seconds)


def _pose(candidate: Candidate | None) -> FloatArray | None:
    return None if candidate is None else candidate.T_local_query


def localizer_config(method: str, neighbours: int, *, noisy: bool = False) -> Config:
    """What ships, but the noise of the queries is known, and a descriptor alone retrieves.

    The map is exact. The noise that grows with the range is halved between the two submaps that are compared.
    """
    config = Config()
    retrieval = {} if method == EXHAUSTIVE else {"descriptor": method, "top_k": neighbours}
    per_m = NOISE_PER_M / np.sqrt(2.0) if noisy else 0.0
    config = config.calibrated({"objects.landmark_sigma_m": MAP_SIGMA_M, "objects.landmark_sigma_per_m": per_m})
    return config.model_copy(
        update={
            "loop_closure": config.loop_closure.model_copy(update=retrieval),
            "registration": config.registration.model_copy(update={"estimate_scale": noisy}),
        }
    )


def query_sigmas(query: LocalQuery, scenario: Scenario) -> FloatArray:
    """Noise (N,) m of the positions of a query, which grows with the range."""
    ranges = np.linalg.norm(query.positions, axis=1)
    return np.asarray(MAP_SIGMA_M + (NOISE_PER_M * ranges if scenario.noisy else 0.0 * ranges))


def _measure(
    method: str, localize: Localizer, objects: LabelledMap, scenario: Scenario, drawn: list[list[LocalQuery]]
) -> dict[str, float | None]:
    answers = [(localize(query, scenario), query, seed) for seed, queries in enumerate(drawn) for query in queries]
    asked = [query for _, query, _ in answers]
    is_success = [hits(answer.T_map_query, query) for answer, query, _ in answers]
    success = pd.Series(is_success).groupby([seed for *_, seed in answers]).mean()
    ceiling = float(np.mean([hits(fit_truth(objects, query, scenario), query) for query in asked]))
    is_misplaced = [
        answer.T_map_query is not None and not hits(answer.T_map_query, query, within_m=MISPLACED_M)
        for answer, query, _ in answers
    ]
    return {
        "success": float(success.mean()),
        "deviation": float(success.std(ddof=0)),
        "ceiling": ceiling,
        "of_ceiling": float(success.mean() / ceiling) if ceiling else None,
        "misplaced": float(np.mean(is_misplaced)),
        "likeliest": float(np.mean([hits(answer.T_map_likeliest, query) for answer, query, _ in answers])),
        "top_5": None if method == EXHAUSTIVE else top_share(method, objects, asked, TOP),
        "query_ms": 1e3 * float(np.median([answer.seconds for answer, *_ in answers])),
    }


def hits(T_map_query: FloatArray | None, query: LocalQuery, *, within_m: float = SUCCESS_M) -> bool:
    """Whether a pose (4, 4) is that near to the query's."""
    if T_map_query is None:
        return False
    return bool(np.linalg.norm((T_map_query - query.T_map_query_gt)[:2, 3]) < within_m)


def top_share(method: str, objects: LabelledMap, queries: Sequence[LocalQuery], count: int) -> float | None:
    """Share of the objects of a query whose counterpart is among their ``count`` nearest, its mean over the queries."""
    index = make_index(method)
    index.add(_constellations(objects.positions, objects.labels, objects, index))
    everywhere = np.ones(len(objects), dtype=np.bool_)
    shares = []
    for query in queries:
        if len(query):
            matches = index.search(_constellations(query.positions, query.labels, objects, index), count, everywhere)
            shares.append(np.count_nonzero(query.objects[matches.queries] == matches.entries) / len(query))
    return float(np.mean(shares)) if shares else None


def _constellations(
    positions: FloatArray, labels: IntArray, objects: LabelledMap, index: ConstellationIndex
) -> Constellations:
    return gather_constellations(positions, labels, objects.vocabulary, radius_m=index.radius_m)


def fit_truth(objects: LabelledMap, query: LocalQuery, scenario: Scenario) -> FloatArray | None:
    """The pose (4, 4) by least squares over the true correspondences: the ceiling of every matcher.

    Weighted by the inverse square of the noise, with a scale where a query has one. None for fewer than two objects.
    """
    if len(query) < 2:
        return None
    seen = query.positions[:, 0] + 1j * query.positions[:, 1]
    known = objects.positions[query.objects, 0] + 1j * objects.positions[query.objects, 1]
    weights = 1.0 / query_sigmas(query, scenario) ** 2
    weights /= weights.sum()
    seen_middle, known_middle = weights @ seen, weights @ known
    product = np.sum(weights * np.conj(seen - seen_middle) * (known - known_middle))
    spread = np.sum(weights * np.abs(seen - seen_middle) ** 2)
    if not (abs(product) > 0.0 and spread > 0.0):
        return None
    turn = product / spread if scenario.noisy else product / abs(product)
    place = known_middle - turn * seen_middle
    T_map_query = query.T_map_query_gt.copy()
    T_map_query[:2, 3] = place.real, place.imag
    return T_map_query
