"""Whether the posterior probabilities of places are right as often as they say: a reliability diagram in numbers.

Of each query the likeliest candidate has posterior odds against "somewhere new". If they are calibrated, of all that
have the probability p a share p is right (DeGroot and Fienberg, The Statistician 1983).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from slam.common.arrays import FloatArray, IntArray
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
    """Bin the candidates that have posterior odds of their own, those that the truth decides alone."""
    rows = [
        row
        for row, candidate in enumerate(judged.candidates)
        if candidate.accumulated_log_likelihood_ratio is not None
        and candidate.seed_query_keyframe_id is None
        and judged.decided[row]
    ]
    odds = [judged.candidates[row].accumulated_log_likelihood_ratio for row in rows]
    probabilities = expit(np.array(odds, dtype=np.float64))
    right = judged.true[rows].astype(np.float64)
    bins = np.searchsorted(EDGES, probabilities, side="right")
    counts, sums, rights = (np.bincount(bins, each, len(EDGES) + 1) for each in (None, probabilities, right))
    with np.errstate(invalid="ignore"):
        expected = sums / counts
    sure = probabilities >= SURE
    return Reliability(counts, expected, rights.astype(np.int64), int(sure.sum()), int(right[sure].sum()))
