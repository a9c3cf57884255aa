"""The two protocols by which papers measure place recognition: pairs of frames, and each frame against all before it.

Papers score all pairs of frames by their similarity. A run proposes a few places at each keyframe; all other pairs have
the lowest score.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from logs.messages import FactorGraphRecord, LoopClosureRecord
from slam.common.arrays import FloatArray, IntArray
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.place_recognition.precision_recall import ScoreSweep, sweep_counts, sweep_scores
from slam.evaluation.place_recognition.revisits import find_true_poses


@dataclass(frozen=True, slots=True, eq=False)
class PairQuality:
    """Pairs of keyframes by their true distance, and how many of both kinds candidates claim to be one place.

    ``sweep`` is None without a positive pair, and where candidates claim no pair of either kind.
    """

    positive_count: int
    negative_count: int
    claimed_positive_count: int
    claimed_negative_count: int
    sweep: ScoreSweep | None


@dataclass(frozen=True, slots=True, eq=False)
class OnlineQuality:
    """``query_count`` keyframes have others far enough back, ``revisit_count`` of them are near one of those.

    ``found_count``: revisits whose answer is right. ``sweep`` is None without a revisit.
    """

    query_count: int
    revisit_count: int
    found_count: int
    sweep: ScoreSweep | None

    @property
    def recall_at_1(self) -> float | None:
        """Share of the revisits whose answer is right, whatever its score; None without a revisit."""
        return self.found_count / self.revisit_count if self.revisit_count else None


@dataclass(frozen=True, slots=True, eq=False)
class ComparedKeyframes:
    """The K keyframes with truth in the order of time, and what C candidates claim of them; K and C may be 0.

    frames (K,), which do not fall; true_positions (K, 3) m, world frame; map_positions (K, 3) m, final map; query_rows
    (C,): the keyframe of each candidate among the K; claimed_positions (C, 3) m, where it puts that in the final map;
    scores (C,).
    """

    frames: IntArray
    true_positions: FloatArray
    map_positions: FloatArray
    query_rows: IntArray
    claimed_positions: FloatArray
    scores: FloatArray


def number_frames(keyframe_stamps_ns: IntArray, odometry_stamps_ns: IntArray) -> IntArray:
    """Number (K,) of the frame that each keyframe (K,) is: of odometry messages, or of keyframes where there is none.

    Args:
        keyframe_stamps_ns: (K,) int64, in any order.
        odometry_stamps_ns: (N,) int64, strictly increasing; N may be 0.
    """
    frames_ns = odometry_stamps_ns if len(odometry_stamps_ns) else np.unique(keyframe_stamps_ns)
    return np.searchsorted(frames_ns, keyframe_stamps_ns).astype(np.int64)


def compare_keyframes(
    candidates: Sequence[LoopClosureRecord],
    graph: FactorGraphRecord,
    odometry_stamps_ns: IntArray,
    truth: PoseSeries,
    protocol: Protocol,
) -> ComparedKeyframes:
    """Bring keyframes, their truth and what candidates claim of them together.

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
    compared_row = dict(zip(graph.keyframe_ids[rows].tolist(), range(len(rows)), strict=True))
    graph_row = dict(zip(graph.keyframe_ids.tolist(), range(len(graph.keyframe_ids)), strict=True))
    usable = [
        (c, c.T_reference_query)
        for c in candidates
        if c.T_reference_query is not None
        and c.query_keyframe_id in compared_row
        and c.reference_keyframe_id in graph_row
    ]
    T_map_reference = graph.T_map_body[[graph_row[c.reference_keyframe_id] for c, _ in usable]]
    T_reference_query = np.array([T for _, T in usable]).reshape(-1, 4, 4)
    return ComparedKeyframes(
        frames=number_frames(stamps_ns[rows], odometry_stamps_ns),
        true_positions=T_world_body[rows, :3, 3],
        map_positions=graph.T_map_body[rows, :3, 3],
        query_rows=np.array([compared_row[c.query_keyframe_id] for c, _ in usable], dtype=np.int64),
        claimed_positions=(T_map_reference @ T_reference_query)[:, :3, 3],
        scores=np.array([c.score for c, _ in usable], dtype=np.float64),
    )


def evaluate_pairs(keyframes: ComparedKeyframes, protocol: Protocol) -> PairQuality:
    """The protocol of pairs: those near each other against those far from each other, scored by the candidates.

    * A pair is positive if it is less than ``pair_positive_m`` and more than ``pair_frames`` frames apart, negative if
      it is more than ``pair_negative_m`` apart, between true positions in 3-D; others do not count.
    * A candidate of the later keyframe claims the pair if it puts that keyframe less than ``pair_positive_m`` from
      where the final map has the earlier one. The pair has the best score of those that claim it, else the lowest.
    """
    count = len(keyframes.frames)
    positives = _find_positives(keyframes, protocol)
    near = _pairs_within(keyframes.true_positions, protocol.pair_negative_m)
    negative_count = count * (count - 1) // 2 - len(near)
    claims = _find_claims(keyframes, protocol)
    best = claims.groupby(claims["row"] * count + claims["query"])["score"].max()
    codes = best.index.to_numpy()
    is_positive = np.isin(codes, positives[:, 0] * count + positives[:, 1])
    is_negative = ~np.isin(codes, near[:, 0] * count + near[:, 1])
    counted = is_positive | is_negative
    claimed_positives, claimed_negatives = int(is_positive.sum()), int(is_negative.sum())
    sweep = None
    if len(positives) and counted.any():
        rest_true, rest_false = len(positives) - claimed_positives, negative_count - claimed_negatives
        rest = [rest_true + rest_false] if rest_true + rest_false else []
        true = np.append(is_positive[counted].astype(np.int64), rest_true if rest else [])
        sweep = sweep_counts(
            np.append(best.to_numpy()[counted], [-np.inf] if rest else []),
            accepted_counts=np.append(np.ones(int(counted.sum()), dtype=np.int64), rest).astype(np.int64),
            true_counts=true.astype(np.int64),
            recalled_counts=true.astype(np.int64),
            relevant_count=len(positives),
        )
    return PairQuality(len(positives), negative_count, claimed_positives, claimed_negatives, sweep)


def evaluate_online(keyframes: ComparedKeyframes, protocol: Protocol) -> OnlineQuality:
    """The online protocol: each keyframe as a query against all that are more than ``pair_frames`` frames before it.

    * A query is a revisit if one of those is less than ``pair_positive_m`` from it, between true positions in 3-D.
    * Its answer is the one of those that is nearest to where its best-scoring candidate puts it in the final map, if
      that is less than ``pair_positive_m`` away; else it has none. It is right if it makes the query a revisit.
    """
    frames = keyframes.frames
    revisit_rows = np.unique(_find_positives(keyframes, protocol)[:, 1])
    claims = _find_claims(keyframes, protocol)
    claims = claims[frames[claims["query"]] - frames[claims["row"]] > protocol.pair_frames]
    ranked = pd.Series(_rank(keyframes.scores))
    is_best = (ranked == ranked.groupby(keyframes.query_rows).transform("max")).to_numpy(dtype=np.bool_)
    claims = claims[is_best[claims["candidate"]]].sort_values(["candidate", "apart_m", "row"])
    answers = claims.drop_duplicates("candidate")
    queries, rows = answers["query"].to_numpy(), answers["row"].to_numpy()
    true_m = np.linalg.norm(keyframes.true_positions[queries] - keyframes.true_positions[rows], axis=1)
    scores = keyframes.scores[answers["candidate"]]
    sweep = sweep_scores(queries, scores, true_m < protocol.pair_positive_m, revisit_ids=revisit_rows)
    recalled = float(sweep.recall[-1]) if sweep is not None and len(sweep.recall) else 0.0
    return OnlineQuality(
        query_count=int(np.count_nonzero(frames - frames.min(initial=0) > protocol.pair_frames)),
        revisit_count=len(revisit_rows),
        found_count=round(recalled * len(revisit_rows)),
        sweep=sweep,
    )


def _rank(scores: FloatArray) -> FloatArray:
    """Scores (C,), those that are not a number below all others."""
    return np.where(np.isnan(scores), -np.inf, scores)


def _pairs_within(positions: FloatArray, distance_m: float) -> IntArray:
    """Rows (P, 2), the smaller first, of positions (K, 3) at most so far apart."""
    if len(positions) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    pairs: IntArray = cKDTree(positions).query_pairs(distance_m, output_type="ndarray")
    return pairs


def _find_positives(keyframes: ComparedKeyframes, protocol: Protocol) -> IntArray:
    """Rows (P, 2) of the positive pairs, the earlier first."""
    positions, frames = keyframes.true_positions, keyframes.frames
    pairs = _pairs_within(positions, protocol.pair_positive_m)
    earlier, later = pairs[:, 0], pairs[:, 1]
    apart_m = np.linalg.norm(positions[earlier] - positions[later], axis=1)
    are_positive = (apart_m < protocol.pair_positive_m) & (frames[later] - frames[earlier] > protocol.pair_frames)
    return pairs[np.flatnonzero(are_positive)]


def _find_claims(keyframes: ComparedKeyframes, protocol: Protocol) -> pd.DataFrame:
    """Which ``candidate`` puts its ``query`` keyframe less than ``pair_positive_m`` from which earlier one (``row``).

    ``apart_m``: how far, in the final map; ``score``: of the candidate.
    """
    if len(keyframes.query_rows) == 0:
        return pd.DataFrame(columns=["candidate", "row", "apart_m", "query", "score"], dtype=np.int64)
    found = cKDTree(keyframes.claimed_positions).sparse_distance_matrix(
        cKDTree(keyframes.map_positions), protocol.pair_positive_m, output_type="ndarray"
    )
    claims = pd.DataFrame({"candidate": found["i"], "row": found["j"], "apart_m": found["v"]})
    claims = claims.assign(
        query=keyframes.query_rows[claims["candidate"]], score=_rank(keyframes.scores)[claims["candidate"]]
    )
    return claims[(claims["row"] < claims["query"]) & (claims["apart_m"] < protocol.pair_positive_m)]
