"""Precision and recall of every threshold on the score."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from slam.common.arrays import BoolArray, FloatArray, IntArray


def sweep_scores(
    query_ids: IntArray, scores: FloatArray, is_true: BoolArray, *, revisit_ids: IntArray
) -> pd.DataFrame | None:
    """Sweep a threshold over the best-scoring candidate of each query.

    Of several best candidates of one query with equal scores a false one stands for all. Equal scores of several
    queries are accepted together. A score that is not a number is the lowest.

    Args:
        query_ids: (C,) int64, query keyframe of each candidate, which has a transform and a truth; C may be 0.
        scores: (C,) float64, larger is better.
        is_true: (C,) bool.
        revisit_ids: (R,) int64, the keyframes whose candidates count for recall; all count for precision.

    Returns:
        ``thresholds``, which fall, ``precision`` and ``recall`` of accepting every score at or above each; None where
        there is no revisit, which leaves recall undefined.
    """
    if len(revisit_ids) == 0:
        return None
    ranked = np.where(np.isnan(scores), -np.inf, scores)
    candidates = pd.DataFrame({"query": query_ids, "score": ranked, "true": is_true})
    best = candidates.sort_values(["score", "true"], ascending=[False, True]).drop_duplicates("query")
    best = best.assign(accepted=1, recalled=best["true"] & best["query"].isin(revisit_ids))
    counts = best.groupby("score")[["accepted", "true", "recalled"]].sum().sort_index(ascending=False).cumsum()
    return pd.DataFrame(
        {
            "thresholds": counts.index.to_numpy(),
            "precision": (counts["true"] / counts["accepted"]).to_numpy(),
            "recall": (counts["recalled"] / len(revisit_ids)).to_numpy(),
        }
    )


def describe_sweep(sweep: pd.DataFrame | None) -> dict[str, Any]:
    """Figures of a sweep by the keys of the JSON, None without a sweep or a candidate; and the curve.

    * ``average_precision``: sum of ``(R_n - R_(n-1)) P_n``, as scikit-learn defines it, but with recall over all
      revisits, so that one without a true best candidate is missed at every threshold.
    * ``recall_at_full_precision``: the largest recall of a threshold that accepts nothing false; 0 where the best score
      is false.
    """
    if sweep is None:
        sweep = pd.DataFrame({"thresholds": [], "precision": [], "recall": []})
    precision, recall = sweep["precision"].to_numpy(), sweep["recall"].to_numpy()
    average = float(np.sum(np.diff(recall, prepend=0.0) * precision))
    at_full_precision = float(recall[precision == 1.0].max(initial=0.0))
    return {
        "average_precision": None if sweep.empty else average,
        "recall_at_full_precision": None if sweep.empty else at_full_precision,
        "precision_recall_curve": sweep.to_dict("list"),
    }
