"""Statistics of kidnappings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from slam.evaluation.metrics.statistics import percentile
from slam.evaluation.place_recognition.reliability import bin_by_probability
from tools.lab.relocalization.trial import RECOVERED_WITHIN_M, Verdict

OBJECTS_IN_VIEW = {"0-4 objects": (0, 4), "5-9 objects": (5, 9), "10-19 objects": (10, 19), "20+ objects": (20, np.inf)}
RATES = {
    "success_rate": Verdict.RECOVERED,
    "late_rate": Verdict.LATE,
    "false_relocalization_rate": Verdict.WRONG,
    "not_found_rate": Verdict.NOT_FOUND,
}


def sum_up(outcomes: Sequence[Mapping[str, Any]], **about: Any) -> dict[str, Any]:
    """All figures of at least one outcome, in types of JSON.

    Args:
        outcomes: as :func:`tools.lab.relocalization.trial.put_down` returns them.
        about: what else is known of the benchmark.

    Returns:
        What is given, the figures of all outcomes (:func:`figures`), those of ``groups`` by direction and by the number
        of objects in range, ``load_s`` (median time to load the map), ``query_ms`` (median time of a search),
        ``reliability`` of the posterior probabilities of all places, and the ``outcomes``.
    """
    table = pd.DataFrame(outcomes, dtype=object)
    is_along = table["is_along"].astype(bool)
    groups = {"same direction": table[is_along], "opposite direction": table[~is_along]}
    groups |= {name: table[table["objects"].between(*bounds)] for name, bounds in OBJECTS_IN_VIEW.items()}
    places = [place for each in table["places"] for place in each]
    return {
        **about,
        **figures(table),
        "load_s": percentile(table["load_s"], 50.0),
        "query_ms": percentile([ms for each in table["query_ms"] for ms in each], 50.0),
        "groups": {name: figures(group) for name, group in groups.items()},
        "reliability": bin_by_probability(
            np.array([odds for odds, _ in places], dtype=np.float64),
            np.array([right for _, right in places], dtype=np.bool_),
        ),
        "outcomes": [dict(each) for each in outcomes],
    }


def figures(table: pd.DataFrame) -> dict[str, float | None]:
    """Shares and percentiles of any number of outcomes, one a row; None where there is nothing to measure.

    The shares of the verdicts add up to 1. ``success_in_map_rate``: share that came soon enough, and right if the map
    is taken at its word about where its own drive was nearby: what relocalization does, whatever the error of the map.
    ``misplaced_rate``: share of fixes that are wrong by that measure. Distance and time are those of the right fixes,
    late ones included; errors those of all fixes. ``kept_rate``: share of the right fixes that are still right 10 m
    later; ``revoked_rate``: share of the wrong fixes that are revoked, or have become right, 10 m later.
    """
    right = table[table["verdict"].isin([Verdict.RECOVERED, Verdict.LATE])]
    wrong = table[table["verdict"] == Verdict.WRONG]
    is_misplaced = table["is_misplaced"].eq(True)
    is_soon = table["distance_m"].astype(float) <= RECOVERED_WITHIN_M
    return {
        "kidnaps": len(table),
        **{name: _share(table["verdict"] == verdict) for name, verdict in RATES.items()},
        "success_in_map_rate": _share(is_soon & ~is_misplaced),
        "misplaced_rate": _share(is_misplaced),
        "median_distance_m": percentile(right["distance_m"], 50.0),
        "p95_distance_m": percentile(right["distance_m"], 95.0),
        "median_seconds": percentile(right["seconds"], 50.0),
        "median_error_m": percentile(table["error_m"], 50.0),
        "p95_error_m": percentile(table["error_m"], 95.0),
        "median_error_deg": percentile(table["error_deg"], 50.0),
        "p95_error_deg": percentile(table["error_deg"], 95.0),
        "kept_rate": _share(right["later_right"].eq(True)),
        "revoked_rate": _share(~wrong["later_right"].eq(False)),
    }


def _share(whether: pd.Series) -> float | None:
    return float(whether.mean()) if len(whether) else None
