"""Statistics of kidnappings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from slam.evaluation.metrics.statistics import percentile
from tools.lab.relocalization.trial import Verdict

GROUPS = {
    "same direction": ("is_along", True, True),
    "opposite direction": ("is_along", False, False),
    "0-4 objects": ("objects", 0, 4),
    "5-9 objects": ("objects", 5, 9),
    "10-19 objects": ("objects", 10, 19),
    "20+ objects": ("objects", 20, np.inf),
}
"""Column of the outcomes, and its lowest and highest value."""


def sum_up(outcomes: Sequence[Mapping[str, Any]], **about: Any) -> dict[str, Any]:
    """All figures of at least one outcome, in types of JSON.

    Args:
        outcomes: as :func:`tools.lab.relocalization.trial.put_down` returns them.
        about: what else is known of the benchmark.

    Returns:
        What is given, the figures of all outcomes (:func:`figures`), those of each of the ``groups`` that has any,
        ``load_s`` (median time to load the map), ``query_ms`` (median time of a search), and the ``outcomes``.
    """
    table = pd.DataFrame(outcomes, dtype=object)
    groups = {name: table[table[column].between(low, high)] for name, (column, low, high) in GROUPS.items()}
    return {
        **about,
        **figures(table),
        "load_s": percentile(table["load_s"], 50.0),
        "query_ms": percentile([ms for each in table["query_ms"] for ms in each], 50.0),
        "groups": {name: figures(group) for name, group in groups.items() if len(group)},
        "outcomes": [dict(each) for each in outcomes],
    }


def figures(table: pd.DataFrame) -> dict[str, float | None]:
    """Shares and percentiles of any number of outcomes, one a row; None where there is nothing to measure.

    The first four shares add up to 1. Distance and time are those of the right fixes, late ones included; errors those
    of all fixes. ``kept_rate``: share of the right fixes that are still right 10 m later; ``revoked_rate``: share of
    the wrong fixes that are revoked, or have become right, 10 m later.
    """
    verdict, later = table["verdict"], table["later_right"]
    is_right = verdict.isin([Verdict.RECOVERED, Verdict.LATE])
    shares = {
        "success_rate": verdict == Verdict.RECOVERED,
        "late_rate": verdict == Verdict.LATE,
        "false_relocalization_rate": verdict == Verdict.WRONG,
        "not_found_rate": verdict == Verdict.NOT_FOUND,
        "kept_rate": later[is_right].eq(True),
        "revoked_rate": ~later[verdict == Verdict.WRONG].eq(False),
    }
    return {
        "kidnaps": len(table),
        **{name: float(whether.mean()) if len(whether) else None for name, whether in shares.items()},
        "median_distance_m": percentile(table["distance_m"][is_right], 50.0),
        "p95_distance_m": percentile(table["distance_m"][is_right], 95.0),
        "median_seconds": percentile(table["seconds"][is_right], 50.0),
        "median_error_m": percentile(table["error_m"], 50.0),
        "p95_error_m": percentile(table["error_m"], 95.0),
        "median_error_deg": percentile(table["error_deg"], 50.0),
        "p95_error_deg": percentile(table["error_deg"], 95.0),
    }
