"""Whether the posterior probabilities of places are right as often as they say: a reliability diagram in numbers.

Of each query the likeliest candidate has posterior odds against "somewhere new". If they are calibrated, of all that
have the probability p a share p is right (DeGroot and Fienberg, The Statistician 1983).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.evaluation.place_recognition.closure_labels import JudgedClosures

EDGES = np.array([0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999])
"""Probabilities between the bins."""
SURE = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """Candidates by probability, in B bins between ``EDGES``: how many (B,), their mean probability (B,), NaN without
    one, and how many of them are right (B,). ``sure_count`` and ``sure_right``: those of at least :data:`SURE`.
    """

    counts: IntArray
    expected: FloatArray
    right: IntArray
    sure_count: int
    sure_right: int


def measure_reliability(judged: JudgedClosures) -> Reliability:
    """That of the candidates with posterior odds which no other closure predicted and which the truth decides."""
    rows = [
        row
        for row, candidate in enumerate(judged.candidates)
        if candidate.posterior_log_odds is not None and candidate.seed_query_keyframe_id is None and judged.decided[row]
    ]
    odds = np.array([judged.candidates[row].posterior_log_odds for row in rows], dtype=np.float64)
    return bin_by_probability(odds, judged.true[rows])


def bin_by_probability(log_odds: FloatArray, is_right: BoolArray) -> Reliability:
    """The reliability of N places with posterior ``log_odds`` (N,), of which ``is_right`` (N,)."""
    probabilities, right = expit(log_odds), is_right.astype(np.float64)
    bins = np.searchsorted(EDGES, probabilities, side="right")
    counts, sums, rights = (np.bincount(bins, each, len(EDGES) + 1) for each in (None, probabilities, right))
    with np.errstate(invalid="ignore"):
        expected = sums / counts
    sure = probabilities >= SURE
    return Reliability(counts, expected, rights.astype(np.int64), int(sure.sum()), int(right[sure].sum()))


def reliability_dict(reliability: Reliability | None) -> dict[str, Any]:
    """The reliability as JSON: bins with their edges, empty without any."""
    if reliability is None:
        return {"bins": [], "sure_count": None, "sure_right": None}
    edges = [0.0, *EDGES.tolist(), 1.0]
    columns = (each.tolist() for each in (reliability.counts, reliability.expected, reliability.right))
    bins = [
        {"from": low, "to": high, "count": count, "expected": expected if count else None, "right": right}
        for low, high, count, expected, right in zip(edges[:-1], edges[1:], *columns, strict=True)
    ]
    return {"bins": bins, "sure_count": reliability.sure_count, "sure_right": reliability.sure_right}
