"""What any threshold on the score would have accepted: precision against recall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray

CURVE_POINTS = 500
"""A curve with more points is thinned to about that many where it is written or drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class ScoreSweep:
    """Precision and recall (P,) of accepting every score at or above each of ``thresholds`` (P,), which fall.

    P = 0 without candidates; the summaries are None then. The lowest threshold may be minus infinity.
    """

    thresholds: FloatArray
    precision: FloatArray
    recall: FloatArray

    @property
    def average_precision(self) -> float | None:
        """Sum of ``(R_n - R_(n-1)) P_n``, as scikit-learn defines it, but with recall over all revisits.

        Revisits without a true best candidate thus count as missed at every threshold.
        """
        if len(self.thresholds) == 0:
            return None
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.precision))

    @property
    def f1_max(self) -> float | None:
        """The largest harmonic mean of precision and recall."""
        return float(np.max(self._f1)) if len(self.thresholds) else None

    @property
    def recall_at_full_precision(self) -> float | None:
        """The largest recall of a threshold that accepts nothing false; 0 where the best score is false."""
        if len(self.thresholds) == 0:
            return None
        return float(np.max(self.recall[self.precision == 1.0], initial=0.0))

    @property
    def extended_precision(self) -> float | None:
        """``(P_R0 + R_P100) / 2``: precision at the highest threshold, and the recall at full precision.

        Where the best score is false there is no threshold with full precision: R_P100 is 0, and so is P_R0 unless true
        candidates share that score.

        Source: Ferrarini et al., "Exploring performance bounds of visual place recognition using extended precision",
        RA-L 2020, eq. (7).
        """
        recall = self.recall_at_full_precision
        return None if recall is None else 0.5 * (float(self.precision[0]) + recall)

    def thinned(self, most: int = CURVE_POINTS) -> ScoreSweep:
        """The same curve with at most ``most`` points, evenly by their order, and two more at most.

        Both ends stay, and the points of the largest F1 and of the recall at full precision.
        """
        count = len(self.thresholds)
        if count <= most:
            return self
        evenly = np.round(np.linspace(0, count - 1, most)).astype(np.int64)
        full = np.flatnonzero(self.precision == 1.0)[-1:]
        kept = np.unique(np.concatenate([evenly, full, [int(np.argmax(self._f1))]]))
        return ScoreSweep(self.thresholds[kept], self.precision[kept], self.recall[kept])

    @property
    def _f1(self) -> FloatArray:
        sums = self.precision + self.recall
        products = 2.0 * self.precision * self.recall
        return np.divide(products, sums, out=np.zeros_like(sums), where=sums > 0.0)


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
    recalled = is_true[best] & np.isin(query_ids[best], revisit_ids)
    return sweep_counts(
        ranked[best],
        accepted_counts=np.ones(len(best), dtype=np.int64),
        true_counts=is_true[best].astype(np.int64),
        recalled_counts=recalled.astype(np.int64),
        relevant_count=len(revisit_ids),
    )


def sweep_counts(
    scores: FloatArray,
    *,
    accepted_counts: IntArray,
    true_counts: IntArray,
    recalled_counts: IntArray,
    relevant_count: int,
) -> ScoreSweep:
    """Sweep a threshold over G groups that are accepted as a whole, each with one score; equal scores go together.

    Args:
        scores: (G,) float64, no NaN; G may be 0.
        accepted_counts: (G,) int64 >= 1, members of each group.
        true_counts: (G,) int64, those of them that are right.
        recalled_counts: (G,) int64, those that count for recall.
        relevant_count: >= 1, what recall is measured against.
    """
    order = np.argsort(-scores, kind="stable")
    ranked = scores[order]
    last_of_threshold = np.flatnonzero(np.append(ranked[1:] != ranked[:-1], True)[: len(ranked)])
    accepted, true, recalled = (
        np.cumsum(counts[order])[last_of_threshold] for counts in (accepted_counts, true_counts, recalled_counts)
    )
    return ScoreSweep(ranked[last_of_threshold], true / accepted, recalled / relevant_count)
