"""Whether each loop-closure candidate is right, by the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from logs.messages import LoopClosureRecord
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import invert, rotation_angle_rad, yaw_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.place_recognition.revisits import find_true_poses


@dataclass(frozen=True, slots=True, eq=False)
class JudgedClosures:
    """C candidates, each the final decision of two keyframes, by query stamp; C may be 0.

    accepted, decided, true (C,): whether it was accepted, whether it has a transform and a truth, whether it is right
    (false where undecided); same_place (C,): the two keyframes are near each other, with or without a transform;
    reference_stamps_ns (C,): 0 where neither the candidate nor a keyframe holds it;
    errors_xyz (C, 3) metres, world frame: where the closure puts the query keyframe, less where it is;
    rotation_errors_rad (C,); planar_errors (C, 3): the same in the plane of the query's body, forward and left [m], and
    about its z axis [rad]; all 0 where undecided. travelled_m (C,): true path up to the query keyframe.
    """

    candidates: tuple[LoopClosureRecord, ...]
    reference_stamps_ns: IntArray
    accepted: BoolArray
    decided: BoolArray
    true: BoolArray
    same_place: BoolArray
    errors_xyz: FloatArray
    rotation_errors_rad: FloatArray
    planar_errors: FloatArray
    travelled_m: FloatArray

    @property
    def query_ids(self) -> IntArray:
        """Query keyframe (C,) of each candidate."""
        return np.array([c.query_keyframe_id for c in self.candidates], dtype=np.int64)

    @property
    def query_stamps_ns(self) -> IntArray:
        """Stamp (C,) of the query keyframe of each candidate."""
        return np.array([c.stamp_ns for c in self.candidates], dtype=np.int64)

    @property
    def scores(self) -> FloatArray:
        """Score (C,) of each candidate, larger is better."""
        return np.array([c.score for c in self.candidates], dtype=np.float64)


def label_closures(
    candidates: tuple[LoopClosureRecord, ...],
    stamp_of_keyframe: Mapping[int, int],
    truth: PoseSeries,
    protocol: Protocol,
) -> JudgedClosures:
    """Compare each candidate with the relative pose that the truth gives its keyframes.

    A candidate is right if its transform is within ``closure_translation_m`` and ``closure_rotation_deg``, both
    inclusive, of the true one. Without a transform, or without truth at one of the stamps, it is undecided.

    Args:
        candidates: final decisions, by query stamp.
        stamp_of_keyframe: for logs whose candidates do not tell the stamp of their reference (0).
        truth: may hold no pose.
        protocol: the thresholds.
    """
    count = len(candidates)
    query_ns = np.array([c.stamp_ns for c in candidates], dtype=np.int64)
    reference_ns = np.array(
        [c.reference_stamp_ns or stamp_of_keyframe.get(c.reference_keyframe_id, 0) for c in candidates], dtype=np.int64
    )
    known, poses = find_true_poses(truth, np.concatenate([query_ns, reference_ns]), max_gap_s=protocol.max_truth_gap_s)
    comparable = known[:count] & known[count:]
    T_world_query, T_world_reference = poses[:count], poses[count:]
    registered = np.array([c.T_reference_query is not None for c in candidates], dtype=np.bool_)
    T_reference_query = np.array(
        [np.eye(4) if c.T_reference_query is None else c.T_reference_query for c in candidates]
    ).reshape(-1, 4, 4)
    decided = comparable & registered
    T_world_claimed = T_world_reference @ T_reference_query
    errors_xyz = np.where(decided[:, None], T_world_claimed[:, :3, 3] - T_world_query[:, :3, 3], 0.0)
    T_query_claimed = invert(T_world_query) @ T_world_claimed
    rotation_errors = np.where(decided, rotation_angle_rad(T_query_claimed), 0.0)
    planar_errors = np.column_stack([T_query_claimed[:, 0, 3], T_query_claimed[:, 1, 3], yaw_rad(T_query_claimed)])
    near = np.linalg.norm(errors_xyz, axis=1) <= protocol.closure_translation_m
    turned_alike = rotation_errors <= np.deg2rad(protocol.closure_rotation_deg)
    apart_m = np.linalg.norm(T_world_query[:, :3, 3] - T_world_reference[:, :3, 3], axis=1)
    return JudgedClosures(
        candidates=candidates,
        reference_stamps_ns=reference_ns,
        accepted=np.array([c.accepted for c in candidates], dtype=np.bool_),
        decided=decided,
        true=decided & near & turned_alike,
        same_place=comparable & (apart_m <= protocol.revisit_distance_m),
        errors_xyz=errors_xyz,
        rotation_errors_rad=rotation_errors,
        planar_errors=np.where(decided[:, None], planar_errors, 0.0),
        travelled_m=truth.travelled_at_m(query_ns) if len(truth.stamps_ns) else np.zeros(count),
    )
