"""Origin of accepted closures: found by retrieval, or propagated forwards or backwards from another closure.

A closure that retrieval found is a discovery; those that it predicts for the keyframes after it and before it are
checks of the same discovery. So a precision is as sure as its discoveries are many, and these only count as several
where they have no objects in common.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import betaincinv

from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.metrics.statistics import CONFIDENCE


def describe_discoveries(accepted: pd.DataFrame, protocol: Protocol) -> dict[str, Any]:
    """Accepted closures by their origin, and independent discoveries: found closures that have no objects in common.

    These are runs of found closures that the truth decides; a run ends where the next query is a submap's length
    further on. ``proposer_counts``: accepted closures by what proposed their place; none in logs of earlier versions.

    Args:
        accepted: rows of :func:`slam.evaluation.place_recognition.closures.judge_closures`.
        protocol: the thresholds.
    """
    seeds = np.array([np.nan if r.seed_query_keyframe_id is None else r.seed_query_keyframe_id
                      for r in accepted["record"]], dtype=np.float64)  # fmt: skip
    is_found, is_followed = np.isnan(seeds), seeds < accepted["query"]
    found = accepted[is_found & accepted["decided"]].sort_values("travelled_m", kind="stable")
    runs = (np.diff(found["travelled_m"], prepend=-np.inf) >= protocol.window_m).cumsum()
    independent, independent_false = len(np.unique(runs)), len(np.unique(runs[~found["true"]]))
    found_count = int(is_found.sum())
    proposers = Counter(record.proposer for record in accepted["record"] if record.proposer)
    return {
        "found_count": found_count,
        "followed_count": int(is_followed.sum()),
        "led_back_count": len(accepted) - found_count - int(is_followed.sum()),
        "independent_count": independent,
        "independent_false_count": independent_false,
        "proposer_counts": {"descriptor": 0, **dict(sorted(proposers.items()))} if proposers else {},
        "largest_false_share": largest_false_share(independent, independent_false),
    }


def largest_false_share(count: int, false_count: int) -> float | None:
    """No more than that share of discoveries is false, with 95 % confidence (Clopper and Pearson, Biometrika 1934).

    About 3 / n where none of n is false: the rule of three. None without a discovery.
    """
    if count == 0 or count == false_count:
        return 1.0 if count else None
    return float(betaincinv(false_count + 1, count - false_count, CONFIDENCE))
