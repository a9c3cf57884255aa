"""Localization of single scans with each descriptor, by the experiment of the Descriptellation paper (Section IV).

Verification and acceptance are those of :class:`slam.scan_localization.ScanLocalizer`.
"""

import time
from collections.abc import Sequence

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from logs.messages import ObjectDetections
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.loop_closure.candidate import Candidate
from slam.scan_localization import ScanLocalizer
from tools.console import progress_bar
from tools.lab.retrieval.labelled_map import LabelledMap
from tools.lab.retrieval.paper_queries import SCENARIOS, LocalQuery, Scenario, draw_queries

NOISE_PER_M = 0.08
"""Of a noisy query's positions by range, along any axis: 0.1 / sqrt(3) from its error, and as much from the scale."""


def benchmark_descriptors(
    objects: LabelledMap, tour: FloatArray, methods: Sequence[str], *, queries: int, seeds: int
) -> pd.DataFrame:
    """Every descriptor on the same queries, on one thread.

    Args:
        objects: the map.
        tour: (M, 2) m, where queries are drawn.
        methods: names of descriptors.
        queries: for each scenario and seed.
        seeds: 0 to ``seeds`` - 1.

    Returns:
        A row for each ``method`` and ``scenario``. ``success`` and ``deviation`` over the seeds: shares of the queries
        that are accepted within 1 m. ``misplaced``: share that is accepted farther than 10 m off. ``likeliest``:
        share whose likeliest candidate is within 1 m, accepted or not. ``query_ms``: median processor time.
        ``build_s``: to index the map.

    Raises:
        DescriptorError: a descriptor that the map's classes are too many for.
        SimulationError: a tour without an object in sight.
    """
    drawn = {
        scenario: [
            (seed, query)
            for seed in range(seeds)
            for query in draw_queries(objects, tour, scenario, count=queries, rng=np.random.default_rng((seed, number)))
        ]
        for number, scenario in enumerate(SCENARIOS)
    }
    cells = []
    with threadpool_limits(1), progress_bar("localizing") as show_done:
        for method in methods:
            for scenario, asked in drawn.items():
                figures = _measure(method, objects, scenario, asked)
                cells.append({"method": method, "scenario": scenario.name, **figures})
                show_done(len(cells) / (len(methods) * len(SCENARIOS)))
    return pd.DataFrame(cells, dtype=object)


def localizer_config(method: str, *, noisy: bool = False) -> Config:
    """What ships, but the noise of the queries is known.

    The map is exact. The noise that grows with the range is halved between the two submaps that are compared.
    """
    per_m = NOISE_PER_M / np.sqrt(2.0) if noisy else 0.0
    noise = {"objects.landmark_sigma_m": 0.05, "objects.landmark_sigma_per_m": per_m}
    return Config().calibrated(noise).closing(descriptor=method)


def _measure(
    method: str, objects: LabelledMap, scenario: Scenario, drawn: Sequence[tuple[int, LocalQuery]]
) -> dict[str, float]:
    started = time.process_time()
    localizer = ScanLocalizer(objects.to_record(), localizer_config(method, noisy=scenario.noisy))
    build_s = time.process_time() - started
    rows = []
    for seed, query in drawn:
        scan = ObjectDetections(0, "scan", query.positions, objects.names(query.labels), np.ones(len(query.labels)))
        asked = localizer.query(scan)
        started = time.process_time()
        verified = localizer.propose(asked)
        accepted = localizer.decide(asked, verified).accepted
        candidates = [each for each in verified if isinstance(each, Candidate)]
        seconds = time.process_time() - started
        likeliest = max(candidates, key=lambda each: each.score, default=None)
        rows.append((seed, _error_m(accepted, query), _error_m(likeliest, query), seconds))
    answers = pd.DataFrame(rows, columns=["seed", "accepted_error_m", "likeliest_error_m", "seconds"])
    # 1 m, and 10 m where a query is misplaced, are the paper's limits of an error.
    accepted_m = answers["accepted_error_m"]
    success = (accepted_m < 1.0).groupby(answers["seed"]).mean()
    return {
        "success": success.mean(),
        "deviation": success.std(ddof=0),
        "misplaced": (np.isfinite(accepted_m) & (accepted_m >= 10.0)).mean(),
        "likeliest": (answers["likeliest_error_m"] < 1.0).mean(),
        "query_ms": 1e3 * answers["seconds"].median(),
        "build_s": build_s,
    }


def _error_m(found: Candidate | None, query: LocalQuery) -> float:
    """Distance in the plane from where the query is; infinite without a candidate."""
    if found is None:
        return np.inf
    return float(np.linalg.norm((found.T_local_query - query.T_map_query_gt)[:2, 3]))
