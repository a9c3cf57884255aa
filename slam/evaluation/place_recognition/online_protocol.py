"""The online protocol of papers on place recognition: each frame is looked up among all that came long before it.

Papers score every pair of frames by their similarity. A run proposes a few places at each keyframe, so each keyframe
has one answer at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from logs.messages import FactorGraphRecord, LoopClosureRecord
from slam.common.arrays import FloatArray, IntArray
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.statistics import fraction
from slam.evaluation.place_recognition.precision_recall import describe_sweep, sweep_scores
from slam.evaluation.place_recognition.revisits import find_true_poses


def number_frames(keyframe_stamps_ns: IntArray, odometry_stamps_ns: IntArray) -> IntArray:
    """Number (K,) of the frame that each keyframe (K,) is: of odometry messages, or of keyframes where there is none.

    Args:
        keyframe_stamps_ns: (K,) int64, in any order.
        odometry_stamps_ns: (N,) int64, strictly increasing; N may be 0.
    """
    frames_ns = odometry_stamps_ns if len(odometry_stamps_ns) else np.unique(keyframe_stamps_ns)
    return np.searchsorted(frames_ns, keyframe_stamps_ns).astype(np.int64)


def evaluate_online(
    candidates: Sequence[LoopClosureRecord],
    graph: FactorGraphRecord,
    odometry_stamps_ns: IntArray,
    truth: PoseSeries,
    protocol: Protocol,
) -> dict[str, Any]:
    """Each keyframe as a query against all that are more than ``pair_frames`` frames before it.

    * A query is a revisit if one of those is less than ``pair_positive_m`` from it, between true positions in 3-D.
    * Its answer is the one of those that is nearest to where its best-scoring candidate puts it in the final map, if
      that is less than ``pair_positive_m`` away; else it has none. It is right if it makes the query a revisit.

    Args:
        candidates: final decisions; those without a transform, or with an unknown keyframe, are left out.
        graph: with the final poses of the keyframes.
        odometry_stamps_ns: (N,) strictly increasing; N may be 0.
        truth: may hold no pose.
        protocol: the thresholds.
    """
    stamps_ns = graph.keyframe_stamps_ns
    known, T_world_body = find_true_poses(truth, stamps_ns, max_gap_s=protocol.max_truth_gap_s)
    rows = np.flatnonzero(known)
    rows = rows[np.lexsort((graph.keyframe_ids[rows], stamps_ns[rows]))]
    frames, positions = number_frames(stamps_ns[rows], odometry_stamps_ns), T_world_body[rows, :3, 3]
    near = _within(positions, positions, protocol.pair_positive_m)
    revisits = np.unique(near["from"][frames[near["from"]] - frames[near["to"]] > protocol.pair_frames])
    claims = _find_claims(candidates, graph, rows)
    there = np.stack([*claims["position"], *np.zeros((0, 3))]) if len(claims) else np.zeros((0, 3))
    answers = _within(there, graph.T_map_body[rows, :3, 3], protocol.pair_positive_m)
    answers = answers.assign(**{name: claims[name].to_numpy()[answers["from"]] for name in ("query", "score")})
    long_before = frames[answers["query"]] - frames[answers["to"]] > protocol.pair_frames
    answers = answers[long_before].sort_values(["from", "apart_m", "to"]).drop_duplicates("from")
    queries = answers["query"].to_numpy()
    true_m = np.linalg.norm(positions[queries] - positions[answers["to"]], axis=1)
    sweep = sweep_scores(queries, answers["score"].to_numpy(), true_m < protocol.pair_positive_m, revisit_ids=revisits)
    found = 0 if sweep is None or sweep.empty else round(sweep["recall"].iloc[-1] * len(revisits))
    return {
        "query_count": int(np.count_nonzero(frames - frames.min(initial=0) > protocol.pair_frames)),
        "revisit_count": len(revisits),
        "found_count": found,
        "recall_at_1": fraction(found, len(revisits)),
        **describe_sweep(sweep),
    }


def _find_claims(candidates: Sequence[LoopClosureRecord], graph: FactorGraphRecord, rows: IntArray) -> pd.DataFrame:
    """The best-scoring candidates of each ``query``, a row of ``rows``: their ``score`` and where in the final map they
    put the query, ``position`` (3,) m.
    """
    query_row = dict(zip(graph.keyframe_ids[rows].tolist(), range(len(rows)), strict=True))
    graph_row = dict(zip(graph.keyframe_ids.tolist(), range(len(graph.keyframe_ids)), strict=True))
    claims = [
        (
            query_row[c.query_keyframe_id],
            -np.inf if np.isnan(c.score) else c.score,
            (graph.T_map_body[graph_row[c.reference_keyframe_id]] @ c.T_reference_query)[:3, 3],
        )
        for c in candidates
        if c.T_reference_query is not None and c.query_keyframe_id in query_row and c.reference_keyframe_id in graph_row
    ]
    found = pd.DataFrame(claims, columns=["query", "score", "position"]).astype({"query": np.int64, "score": float})
    return found[found["score"] == found.groupby("query")["score"].transform("max")]


def _within(points: FloatArray, others: FloatArray, distance_m: float) -> pd.DataFrame:
    """Rows ``from`` of points (N, 3) and ``to`` of others (M, 3) that are less than a distance apart, ``apart_m``."""
    if not len(points) or not len(others):
        return pd.DataFrame({"from": np.zeros(0, np.int64), "to": np.zeros(0, np.int64), "apart_m": np.zeros(0)})
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(others), distance_m, output_type="ndarray")
    found = pd.DataFrame({"from": pairs["i"], "to": pairs["j"], "apart_m": pairs["v"]})
    return found[found["apart_m"] < distance_m]
