"""Which keyframes come back to an earlier place, by the truth alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import SPACING_TOLERANCE, Protocol
from slam.evaluation.inputs.synchronization import PoseSeries, synchronize

DIRECTIONS = ("same", "opposite", "crossing")
NO_REVISIT = -1


@dataclass(frozen=True, slots=True, eq=False)
class Revisits:
    """The Q query keyframes of a drive in the order of time, Q may be 0.

    keyframe_ids, stamps_ns (Q,); directions (Q,): index into :data:`DIRECTIONS`, or :data:`NO_REVISIT` where the
    keyframe comes back to no earlier place.
    """

    keyframe_ids: IntArray
    stamps_ns: IntArray
    directions: IntArray

    @property
    def is_revisit(self) -> BoolArray:
        """Whether each query keyframe (Q,) comes back to an earlier place."""
        return np.not_equal(self.directions, NO_REVISIT)


def find_true_poses(truth: PoseSeries, at_ns: IntArray, *, max_gap_s: float) -> tuple[BoolArray, FloatArray]:
    """True poses at any times, by the rules of :func:`slam.evaluation.inputs.synchronization.synchronize`.

    Args:
        truth: may hold no pose.
        at_ns: (M,) int64, in any order and with repetitions; M may be 0.
        max_gap_s: a longer gap of the truth is not bridged.

    Returns:
        Whether the truth is known (M,), and T_world_body (M, 4, 4), the identity where it is not.
    """
    T_world_body = np.tile(np.eye(4), (len(at_ns), 1, 1))
    unique = np.unique(at_ns)
    try:
        poses = synchronize(
            PoseSeries(unique, np.broadcast_to(np.eye(4), (len(unique), 4, 4))), truth, max_gap_s=max_gap_s
        )
    except EvaluationError:
        return np.zeros(len(at_ns), dtype=np.bool_), T_world_body
    rows = np.searchsorted(poses.stamps_ns, at_ns).clip(0, len(poses.stamps_ns) - 1)
    known = poses.stamps_ns[rows] == at_ns
    T_world_body[known] = poses.T_world_body_gt[rows[known]]
    return known, T_world_body


def find_revisits(keyframe_ids: IntArray, stamps_ns: IntArray, truth: PoseSeries, protocol: Protocol) -> Revisits:
    """Thin the keyframes to queries, and find those that are near an earlier keyframe after much travel.

    * Queries: keyframes with truth, in the order of time; the first, then each that is at least ``query_spacing_m``,
      less :data:`~slam.evaluation.inputs.protocol.SPACING_TOLERANCE` of it, of true travel after the query before it.
    * A query is a revisit if any keyframe, thinned out or not, at least ``revisit_m`` of true travel before it lies
      within ``revisit_distance_m`` of it, between true positions in 3-D.
    * Its direction is the angle between the forward (x) axes of the two, the nearest such keyframe standing for all.

    Args:
        keyframe_ids: (K,) int64; K may be 0.
        stamps_ns: (K,) int64, in any order.
        truth: may hold no pose, which leaves no query.
        protocol: the thresholds.
    """
    known, T_world_body = find_true_poses(truth, stamps_ns, max_gap_s=protocol.max_truth_gap_s)
    rows = np.flatnonzero(known)
    rows = rows[np.lexsort((keyframe_ids[rows], stamps_ns[rows]))]
    if len(rows) == 0:
        no_rows = np.zeros(0, dtype=np.int64)
        return Revisits(no_rows, no_rows, no_rows)
    T_world_body = T_world_body[rows]
    travelled_m = truth.travelled_at_m(stamps_ns[rows])
    queries = _thin(travelled_m, (1.0 - SPACING_TOLERANCE) * protocol.query_spacing_m)
    nearest = _find_nearest_earlier(T_world_body[:, :3, 3], travelled_m, queries, protocol)
    directions = np.full(len(queries), NO_REVISIT, dtype=np.int64)
    found = nearest >= 0
    forward = T_world_body[:, :3, 0]
    directions[found] = _classify_directions(forward[queries[found]], forward[nearest[found]], protocol)
    return Revisits(keyframe_ids[rows][queries], stamps_ns[rows][queries], directions)


def _thin(travelled_m: FloatArray, least_m: float) -> IntArray:
    """Rows of the first value and of each that is at least ``least_m`` above the last one kept; values never fall."""
    kept: list[int] = []
    row = 0
    while row < len(travelled_m):
        kept.append(row)
        row = int(np.searchsorted(travelled_m, travelled_m[row] + least_m, side="left"))
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


def _classify_directions(forward_query: FloatArray, forward_reference: FloatArray, protocol: Protocol) -> IntArray:
    """Index (N,) into :data:`DIRECTIONS` from forward axes (N, 3), world frame."""
    cosine = np.einsum("ij,ij->i", forward_query, forward_reference)
    angle_deg = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.where(
        angle_deg <= protocol.same_heading_deg,
        DIRECTIONS.index("same"),
        np.where(angle_deg > protocol.opposite_heading_deg, DIRECTIONS.index("opposite"), DIRECTIONS.index("crossing")),
    ).astype(np.int64)
