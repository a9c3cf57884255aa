"""Revisits of a drive by the truth, and the recognised ones among them."""

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from logs.closures import Stage
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import NO_TRUTH, EvaluationRecords
from slam.evaluation.inputs.synchronization import are_known
from slam.evaluation.metrics.statistics import fraction

DIRECTIONS = ("same", "opposite", "crossing")
NO_TRUE_CANDIDATE = "no true candidate"
_RANKS: dict[str, int] = {stage: rank for rank, stage in enumerate(Stage)}
"""A stage that is not among them comes before all."""


def find_revisits(records: EvaluationRecords, judged: pd.DataFrame | None, protocol: Protocol) -> pd.DataFrame:
    """Thin the keyframes to queries, and find those that are near an earlier keyframe after much travel.

    * Queries: keyframes with truth, in the order of time; the first, then each that is at least ``query_spacing_m`` of
      true travel after the query before it, less 5 %: keyframes placed every 2 m must not be thinned by half.
    * A query is a revisit if any keyframe, thinned out or not, at least ``revisit_m`` of true travel before it lies
      within ``revisit_distance_m`` of it, between true positions in 3-D.
    * Its direction is the angle between the forward (x) axes of the two, the nearest such keyframe standing for all.

    Args:
        records: of the log, the stamps of its keyframes in any order.
        judged: the candidates, None without any.
        protocol: the thresholds.

    Returns:
        A row a query, in the order of time: ``keyframe`` (id), ``stamp_ns``, and ``direction``, one of
        :data:`DIRECTIONS`, "" where it is no revisit.

    Raises:
        EvaluationError: no candidate, truth or keyframe, or a given map.
    """
    graph, truth = records.graph, records.true_path
    if judged is None:
        raise EvaluationError("no loop-closure candidate in the log")
    if not truth:
        raise EvaluationError(NO_TRUTH)
    if graph is None:
        raise EvaluationError("no keyframes in the log (/slam/graph), so revisits are unknown")
    if records.has_prior_map:
        raise EvaluationError("closures with keyframes of a given map have no truth in this log: see relocalization")
    keyframe_ids, stamps_ns = graph.keyframe_ids, graph.keyframe_stamps_ns
    T_world_body = truth.poses_at(stamps_ns)
    rows = np.flatnonzero(are_known(T_world_body))
    rows = rows[np.lexsort((keyframe_ids[rows], stamps_ns[rows]))]
    T_world_body = T_world_body[rows]
    travelled_m = truth.travelled_at_m(stamps_ns[rows])
    queries = _thin(travelled_m, 0.95 * protocol.query_spacing_m)
    nearest = _find_nearest_earlier(T_world_body[:, :3, 3], travelled_m, queries, protocol)
    forward = T_world_body[:, :3, 0]
    cosines = np.einsum("ij,ij->i", forward[queries], forward[nearest])
    angles_deg = np.rad2deg(np.arccos(np.clip(cosines, -1.0, 1.0)))
    number = np.select([angles_deg <= 45.0, angles_deg > 135.0], [0, 1], 2)
    directions = np.where(nearest >= 0, np.array(DIRECTIONS)[number], "")
    return pd.DataFrame(
        {"keyframe": keyframe_ids[rows][queries], "stamp_ns": stamps_ns[rows][queries], "direction": directions}
    )


def describe_revisits(queries: pd.DataFrame, judged: pd.DataFrame) -> dict[str, Any]:
    """How many revisits have an accepted true closure, and at which stage the others were lost.

    ``missed_by_stage``: the farthest stage that a true candidate of a missed revisit reached, or
    :data:`NO_TRUE_CANDIDATE`.

    Args:
        queries: as :func:`find_revisits` returns them.
        judged: as :func:`slam.evaluation.place_recognition.closures.judge_closures` returns them.
    """
    true = judged[judged["true"]]
    revisits = queries[queries["direction"] != ""]
    is_recalled = revisits["keyframe"].isin(true["query"][true["accepted"]])
    recalled, missed = revisits[is_recalled], revisits["keyframe"][~is_recalled]
    farthest = dict(sorted(zip(true["query"], true["stage"], strict=True), key=lambda pair: _RANKS.get(pair[1], -1)))
    found, there = Counter(recalled["direction"]), Counter(revisits["direction"])
    return {
        "revisit_count": len(revisits),
        "recall": fraction(len(recalled), len(revisits)),
        **{f"recall_{name}": fraction(found[name], there[name]) for name in DIRECTIONS},
        **{f"revisit_count_{name}": there[name] for name in DIRECTIONS},
        "missed_by_stage": count_stages(farthest.get(name, NO_TRUE_CANDIDATE) for name in missed),
    }


def count_stages(stages: Iterable[str]) -> dict[str, int]:
    """How often each stage occurs, in the order of the stages."""
    counts = Counter(stages)
    return {stage: counts[stage] for stage in sorted(counts, key=lambda stage: (_RANKS.get(stage, -1), stage))}


def _thin(travelled_m: FloatArray, least_m: float) -> IntArray:
    """Rows of the first value and of each that is at least ``least_m`` above the last one kept; values never fall."""
    kept = []
    row = 0
    while row < len(travelled_m):
        kept.append(row)
        row = np.searchsorted(travelled_m, travelled_m[row] + least_m, side="left")
    return np.array(kept, dtype=np.int64)


def _find_nearest_earlier(
    positions: FloatArray, travelled_m: FloatArray, queries: IntArray, protocol: Protocol
) -> IntArray:
    """Row (Q,) of the nearest keyframe (K, 3) that makes each query a revisit, -1 for none; ties go to the earlier."""
    pairs = cKDTree(positions[queries]).sparse_distance_matrix(
        cKDTree(positions), protocol.revisit_distance_m, output_type="ndarray"
    )
    query, reference, distance_m = pairs["i"], pairs["j"], pairs["v"]
    order = np.lexsort((reference, distance_m, query))
    order = order[travelled_m[queries[query[order]]] - travelled_m[reference[order]] >= protocol.revisit_m]
    nearest = np.full(len(queries), -1, dtype=np.int64)
    hits, first = np.unique(query[order], return_index=True)
    nearest[hits] = reference[order[first]]
    return nearest
