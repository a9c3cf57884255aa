"""Global localization with each descriptor, by the experiment of the Descriptellation paper (Section IV)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from descriptors.index import Matches
from descriptors.registry import make_index
from slam.benchmarks.localization_queries import SCENARIOS, LocalQuery, Scenario, draw_queries
from slam.common.arrays import FloatArray
from slam.common.config import RegistrationConfig
from slam.common.errors import SimulationError
from slam.place_recognition.global_localization import GlobalLocalizer, LabelledMap
from slam.registration.estimate import Registration
from slam.registration.exhaustive_search import ExhaustiveSearch

EXHAUSTIVE = "exhaustive search"

SUCCESS_M = 1.0
TOP = 5
MAP_SIGMA_M = 0.05
NOISE_PER_M = 0.08
"""Of a noisy query's positions by range, along any axis: 0.1 / sqrt(3) from its error, and as much from the scale."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One method in one scenario.

    ``success`` and ``deviation`` over the seeds: shares of the queries within 1 m. ``of_ceiling``: that success by the
    one with true correspondences, None if that is 0. ``top_5``: share of the objects seen whose counterpart is among
    their 5 nearest, ``candidates`` how many each has; None for a search without descriptors. Times are medians of a
    query.
    """

    method: str
    scenario: str
    success: float
    deviation: float
    ceiling: float
    of_ceiling: float | None
    top_5: float | None
    candidates: float | None
    match_ms: float
    verify_ms: float


@dataclass(frozen=True, slots=True)
class DescriptorBenchmark:
    """All cells of a map of ``objects`` objects, and how long each method took to take in the map."""

    objects: int
    classes: int
    queries: int
    seeds: int
    neighbours: int
    cells: tuple[Cell, ...]
    build_s: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a method found for a query; its matches, if it has any; and the time for either part, in seconds."""

    registration: Registration
    matches: Matches | None
    match_s: float
    verify_s: float


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
    registration: str = "vote",
    on_progress: Callable[[str], None] = lambda line: None,
) -> DescriptorBenchmark:
    """Every method on the same queries, on one thread.

    Args:
        objects: the map.
        tour: (M, 2) m, where queries are drawn.
        methods: names of descriptors, or :data:`EXHAUSTIVE`.
        neighbours: candidates for each object.
        queries: for each scenario and seed.
        seeds: 0 to ``seeds`` - 1.
        registration: what verifies the candidates of descriptors, as in ``registration.method``.
        on_progress: called with what was measured.

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
    cells: list[Cell] = []
    build_s: dict[str, float] = {}
    with threadpool_limits(limits=1):
        for method in methods:
            started = time.perf_counter()
            localize = make_localizer(method, objects, neighbours, registration)
            build_s[method] = time.perf_counter() - started
            for scenario in SCENARIOS:
                cell = _measure(method, localize, objects, scenario, drawn[scenario.name])
                cells.append(cell)
                on_progress(f"{method}, {scenario.name}: {100 * cell.success:.1f} %")
    return DescriptorBenchmark(len(objects), len(objects.vocabulary), queries, seeds, neighbours, tuple(cells), build_s)


def make_localizer(method: str, objects: LabelledMap, neighbours: int, registration: str = "vote") -> Localizer:
    """Take in a map for one method: a descriptor's name, or :data:`EXHAUSTIVE`."""
    if method == EXHAUSTIVE:
        return _exhaustive(objects)
    localizer = GlobalLocalizer(objects, make_index(method), neighbours=neighbours)

    def localize(query: LocalQuery, scenario: Scenario) -> Answer:
        found = localizer.localize(
            query.positions,
            query.labels,
            registration_config(scenario, registration),
            query_sigmas=query_sigmas(query, scenario),
            map_sigma_m=MAP_SIGMA_M,
        )
        return Answer(found.registration, found.matches, found.match_s, found.verify_s)

    return localize


def _exhaustive(objects: LabelledMap) -> Localizer:
    sigmas = np.full(len(objects), MAP_SIGMA_M)
    searches = {
        noisy: ExhaustiveSearch(
            objects.positions,
            objects.labels,
            registration_config(Scenario("", noisy=noisy)),
            map_sigmas=sigmas,
        )
        for noisy in (False, True)
    }

    def localize(query: LocalQuery, scenario: Scenario) -> Answer:
        started = time.perf_counter()
        found = searches[scenario.noisy].localize(
            query.positions, query.labels, query_sigmas=query_sigmas(query, scenario)
        )
        return Answer(found, None, 0.0, time.perf_counter() - started)

    return localize


def registration_config(scenario: Scenario, method: str = "vote") -> RegistrationConfig:
    """Two objects determine a pose; a noisy query has a scale of its own."""
    return RegistrationConfig(method=method, min_inliers=2, estimate_scale=scenario.noisy)


def query_sigmas(query: LocalQuery, scenario: Scenario) -> FloatArray:
    """Noise (N,) m of the positions of a query, which grows with the range."""
    ranges = np.linalg.norm(query.positions, axis=1)
    return np.asarray(MAP_SIGMA_M + (NOISE_PER_M * ranges if scenario.noisy else 0.0 * ranges))


def _measure(
    method: str, localize: Localizer, objects: LabelledMap, scenario: Scenario, drawn: list[list[LocalQuery]]
) -> Cell:
    answers = [[localize(query, scenario) for query in queries] for queries in drawn]
    success = [
        np.mean([hits(a.registration.T_reference_query, q) for a, q in zip(each, queries, strict=True)])
        for each, queries in zip(answers, drawn, strict=True)
    ]
    ceiling = np.mean([hits(fit_truth(objects, q, scenario), q) for queries in drawn for q in queries])
    flat = [(a, q) for each, queries in zip(answers, drawn, strict=True) for a, q in zip(each, queries, strict=True)]
    tops = [top_share(a.matches, q, TOP) for a, q in flat if a.matches is not None and len(q)]
    candidates = [len(a.matches.queries) / len(q) for a, q in flat if a.matches is not None and len(q)]
    return Cell(
        method=method,
        scenario=scenario.name,
        success=float(np.mean(success)),
        deviation=float(np.std(success)),
        ceiling=float(ceiling),
        of_ceiling=float(np.mean(success) / ceiling) if ceiling else None,
        top_5=float(np.mean(tops)) if tops else None,
        candidates=float(np.mean(candidates)) if candidates else None,
        match_ms=1e3 * float(np.median([a.match_s for a, _ in flat])),
        verify_ms=1e3 * float(np.median([a.verify_s for a, _ in flat])),
    )


def hits(T_map_query: FloatArray | None, query: LocalQuery) -> bool:
    """Whether a pose (4, 4) is within 1 m of the query's."""
    if T_map_query is None:
        return False
    return bool(np.linalg.norm((T_map_query - query.T_map_query_gt)[:2, 3]) < SUCCESS_M)


def top_share(matches: Matches, query: LocalQuery, count: int) -> float:
    """Share of the objects of a query whose true counterpart is among their ``count`` nearest matches."""
    places = np.arange(len(matches.queries))
    ranks = places - np.searchsorted(matches.queries, matches.queries)
    right = (query.objects[matches.queries] == matches.entries) & (ranks < count)
    return float(np.count_nonzero(right) / len(query))


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
