"""The retrieval stage alone: is the right place among the first that descriptors propose?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from logs.closures import rank_stage
from logs.messages import LoopClosureRecord
from slam.common.arrays import IntArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.place_recognition.closure_labels import label_closures
from slam.evaluation.place_recognition.revisits import Revisits

RECALL_AT = (1, 5, 25)
RETRIEVAL = "retrieval"


@dataclass(frozen=True, slots=True, eq=False)
class RetrievalQuality:
    """``query_count`` revisits at which descriptors were asked for the place; ``hit_counts``: k -> those of them where
    one of the first k proposals is right. ``place_count``: proposals that the run verified for each keyframe.
    """

    query_count: int
    hit_counts: Mapping[int, int]
    place_count: int

    def recall_at(self, k: int) -> float | None:
        """Share of the revisits with a right proposal among the first ``k``.

        Args:
            k: one of :data:`RECALL_AT`.

        Returns:
            None where descriptors were never asked at a revisit, or fewer than ``k`` proposals were verified, the
            others being unknown.
        """
        return self.hit_counts[k] / self.query_count if self.query_count and k <= self.place_count else None

    @property
    def note(self) -> str:
        """Why a recall is undefined; "" where none is."""
        if not self.query_count:
            return "no revisit was looked up by descriptors"
        unknown = [str(k) for k in RECALL_AT if k > self.place_count]
        if not unknown:
            return ""
        return (
            f"recall at {' and '.join(unknown)} is undefined: {self.place_count} places were verified a keyframe; "
            f"replay with --set loop_closure.max_candidates={RECALL_AT[-1]} --set loop_closure.propagation_distance_m=0"
        )


def evaluate_retrieval(
    records: Sequence[LoopClosureRecord],
    revisits: Revisits,
    stamp_of_keyframe: Mapping[int, int],
    truth: PoseSeries,
    protocol: Protocol,
    *,
    place_count: int | None = None,
) -> RetrievalQuality:
    """Recall at 1, 5 and 25 of the proposals that descriptors made.

    A proposal is right if the reference keyframe is within ``revisit_distance_m`` of the query, or the transform is
    true as that of a closure is.

    Args:
        records: all of a log in its order, not only the final decisions: a later record about the same two keyframes
            may be about a closure that another one predicted.
        revisits: as :func:`slam.evaluation.place_recognition.revisits.find_revisits` finds them.
        stamp_of_keyframe: for records that do not tell the stamp of their reference (0).
        truth: may hold no pose.
        protocol: the thresholds.
        place_count: how many proposals the run verified for each keyframe; None takes the largest rank.

    Raises:
        EvaluationError: the log comes from a version that did not record ranks.
    """
    proposals = tuple({(r.query_keyframe_id, r.rank): r for r in records if r.rank > 0}.values())
    # What another closure predicted is at distance 0, and what was found without descriptors infinitely far.
    proposed = (r for r in records if rank_stage(r.stage) > rank_stage(RETRIEVAL))
    if not proposals and any(0.0 < r.retrieval_distance < np.inf for r in proposed):
        raise EvaluationError(
            f"none of {len(records)} records on /slam/closures has a rank: an older version wrote them; replay the log "
            "again"
        )
    asked = {r.query_keyframe_id for r in records if r.rank > 0 or r.stage == RETRIEVAL}
    asked_ids = np.array(
        [name for name in revisits.keyframe_ids[revisits.is_revisit].tolist() if name in asked], dtype=np.int64
    )
    judged = label_closures(proposals, stamp_of_keyframe, truth, protocol)
    ranks = np.array([r.rank for r in proposals], dtype=np.int64)
    right = judged.true | judged.same_place
    return RetrievalQuality(
        query_count=len(asked_ids),
        hit_counts={k: _count_hits(asked_ids, judged.query_ids[right & (ranks <= k)]) for k in RECALL_AT},
        place_count=int(ranks.max(initial=0)) if place_count is None else place_count,
    )


def _count_hits(asked_ids: IntArray, right_ids: IntArray) -> int:
    return int(np.count_nonzero(np.isin(asked_ids, right_ids)))
