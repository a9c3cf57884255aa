"""Reliability of the posterior probabilities of places: a reliability diagram in numbers.

Of each query the likeliest candidate has posterior odds against "somewhere new". If they are calibrated, of all that
have the probability p a share p is right (DeGroot and Fienberg, The Statistician 1983).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import expit

EDGES = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999, 1.0)
"""Probabilities between the bins, and both ends."""
SURE = 0.99


def describe_reliability(judged: pd.DataFrame) -> dict[str, Any]:
    """That of the candidates with posterior odds which no other closure predicted and which the truth decides.

    ``bins``: number, mean probability (None without any) and number of right ones between two ``EDGES``;
    ``sure_count``, ``sure_right``: candidates with a probability of at least :data:`SURE`.

    Args:
        judged: rows of :func:`slam.evaluation.place_recognition.closures.judge_closures`.
    """
    rows = [
        decided and record.posterior_log_odds is not None and record.seed_query_keyframe_id is None
        for record, decided in zip(judged["record"], judged["decided"], strict=True)
    ]
    chosen = judged[np.array(rows, dtype=np.bool_)]
    probabilities = expit(np.array([record.posterior_log_odds for record in chosen["record"]], dtype=np.float64))
    is_right = chosen["true"].to_numpy()
    bin_of = np.searchsorted(EDGES[1:-1], probabilities, side="right")
    bins = []
    for number, (low, high) in enumerate(pairwise(EDGES)):
        inside = bin_of == number
        count, right = int(inside.sum()), int(is_right[inside].sum())
        expected = float(probabilities[inside].mean()) if count else None
        bins.append({"from": low, "to": high, "count": count, "expected": expected, "right": right})
    sure = probabilities >= SURE
    return {"bins": bins, "sure_count": int(sure.sum()), "sure_right": int(is_right[sure].sum())}
