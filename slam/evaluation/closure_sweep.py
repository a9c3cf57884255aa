"""What any threshold on the score would have accepted: precision against recall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class ScoreSweep:
    """Precision and recall (P,) of accepting every score at or above each of ``thresholds`` (P,), which fall.

    P = 0 without candidates; the summaries are 0 then.
    """

    thresholds: FloatArray
    precision: FloatArray
    recall: FloatArray

    @property
    def average_precision(self) -> float:
        """Sum of ``(R_n - R_(n-1)) P_n``, as scikit-learn defines it, but with recall over all revisits.

        Revisits without a true best candidate thus count as missed at every threshold.
        """
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.precision))

    @property
    def f1_max(self) -> float:
        """The largest harmonic mean of precision and recall."""
        sums = self.precision + self.recall
        products = 2.0 * self.precision * self.recall
        return float(np.max(np.divide(products, sums, out=np.zeros_like(sums), where=sums > 0.0), initial=0.0))

    @property
    def recall_at_full_precision(self) -> float:
        """The largest recall of a threshold that accepts nothing false; 0 where the best score is false."""
        return float(np.max(self.recall[self.precision == 1.0], initial=0.0))


def sweep_scores(
    query_ids: IntArray, scores: FloatArray, is_true: BoolArray, *, revisit_ids: IntArray
) -> ScoreSweep | None:
    """Sweep a threshold over the best-scoring candidate of each query.

    Of several best candidates of one query with equal scores a false one stands for all. Equal scores of several
    queries are accepted together. A score that is not a number is the lowest.

    Args:
        query_ids: (C,) int64, query keyframe of each candidate, which has a transform and a truth; C may be 0.
        scores: (C,) float64, larger is better.
        is_true: (C,) bool.
        revisit_ids: (R,) int64, the keyframes whose candidates count for recall; all count for precision.

    Returns:
        None where there is no revisit, which leaves recall undefined.
    """
    if len(revisit_ids) == 0:
        return None
    ranked = np.where(np.isnan(scores), -np.inf, scores)
    order = np.lexsort((is_true, -ranked, query_ids))
    best = order[np.unique(query_ids[order], return_index=True)[1]]
    best = best[np.argsort(-ranked[best], kind="stable")]
    true = is_true[best]
    last_of_threshold = np.flatnonzero(np.append(ranked[best][1:] != ranked[best][:-1], True)[: len(best)])
    true_counts = np.cumsum(true)[last_of_threshold]
    recalled_counts = np.cumsum(true & np.isin(query_ids[best], revisit_ids))[last_of_threshold]
    return ScoreSweep(
        thresholds=ranked[best][last_of_threshold],
        precision=true_counts / (last_of_threshold + 1.0),
        recall=recalled_counts / len(revisit_ids),
    )
