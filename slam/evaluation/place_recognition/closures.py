"""Evaluation of loop closures: a table of all candidates, each compared with the truth, and its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from logs.messages import LoopClosureRecord
from slam.common.geometry import invert, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.statistics import fraction, percentile
from slam.evaluation.place_recognition.discoveries import describe_discoveries
from slam.evaluation.place_recognition.reliability import describe_reliability
from slam.evaluation.place_recognition.revisits import count_stages, find_true_poses


def judge_closures(
    candidates: Sequence[LoopClosureRecord],
    stamp_of_keyframe: Mapping[int, int],
    truth: PoseSeries,
    protocol: Protocol,
) -> pd.DataFrame:
    """Compare each candidate with the relative pose that the truth gives its keyframes.

    A candidate is right if its transform is within ``closure_translation_m`` and ``closure_rotation_deg``, both
    inclusive, of the true one. Without a transform, or without truth at one of the stamps, it is undecided.

    Args:
        candidates: final decisions, by query stamp; there may be none.
        stamp_of_keyframe: for logs whose candidates do not have the stamp of their reference (0).
        truth: may hold no pose.
        protocol: the thresholds.

    Returns:
        A row a candidate: the ``record``; of it ``query`` (id), ``stamp_ns``, ``reference_stamp_ns`` (0 if unknown),
        ``accepted``, ``stage``, ``score``; ``decided``, ``true`` (false where undecided); errors of where it puts the
        query keyframe, 0 where undecided: ``error_m``, ``rotation_rad``; ``travelled_m``: true path up to the query
        keyframe.
    """
    count = len(candidates)
    query_ns = np.array([c.stamp_ns for c in candidates], dtype=np.int64)
    reference_ns = np.array(
        [c.reference_stamp_ns or stamp_of_keyframe.get(c.reference_keyframe_id, 0) for c in candidates], dtype=np.int64
    )
    known, poses = find_true_poses(truth, np.concatenate([query_ns, reference_ns]), max_gap_s=protocol.max_truth_gap_s)
    T_world_query, T_world_reference = poses[:count], poses[count:]
    registered = np.array([c.T_reference_query is not None for c in candidates], dtype=np.bool_)
    T_reference_query = [np.eye(4) if c.T_reference_query is None else c.T_reference_query for c in candidates]
    decided = known[:count] & known[count:] & registered
    T_world_claimed = T_world_reference @ np.array(T_reference_query).reshape(-1, 4, 4)
    error_m = np.linalg.norm(T_world_claimed[:, :3, 3] - T_world_query[:, :3, 3], axis=1)
    rotation_rad = rotation_angle_rad(invert(T_world_query) @ T_world_claimed)
    turned_alike = rotation_rad <= np.deg2rad(protocol.closure_rotation_deg)
    return pd.DataFrame(
        {
            "record": pd.Series(candidates, dtype=object),
            "query": np.array([c.query_keyframe_id for c in candidates], dtype=np.int64),
            "stamp_ns": query_ns,
            "reference_stamp_ns": reference_ns,
            "accepted": np.array([c.accepted for c in candidates], dtype=np.bool_),
            "stage": pd.Series([c.stage for c in candidates], dtype=object),
            "score": np.array([c.score for c in candidates], dtype=np.float64),
            "decided": decided,
            "true": decided & (error_m <= protocol.closure_translation_m) & turned_alike,
            "error_m": np.where(decided, error_m, 0.0),
            "rotation_rad": np.where(decided, rotation_rad, 0.0),
            "travelled_m": truth.travelled_at_m(query_ns) if len(truth) else np.zeros(count),
        }
    )


def describe_closures(judged: pd.DataFrame, protocol: Protocol) -> dict[str, Any]:
    """Counts, precision, errors, discoveries and reliability of the candidates of a drive, by the keys of the JSON.

    Args:
        judged: as :func:`judge_closures` returns them.
        protocol: the thresholds.
    """
    accepted = judged[judged["accepted"]]
    true = accepted[accepted["true"]]
    decided_count, rotations_deg = int(accepted["decided"].sum()), np.rad2deg(true["rotation_rad"])
    return {
        "candidate_count": len(judged),
        "accepted_count": len(accepted),
        "inserted_count": sum(record.inserted for record in judged["record"]),
        "true_count": len(true),
        "false_count": decided_count - len(true),
        "undecided_count": len(accepted) - decided_count,
        "precision": fraction(len(true), decided_count),
        "stage_counts": count_stages(judged["stage"]),
        **describe_discoveries(accepted, protocol),
        "reliability": describe_reliability(judged),
        "median_translation_error_m": percentile(true["error_m"], 50.0),
        "p95_translation_error_m": percentile(true["error_m"], 95.0),
        "median_rotation_error_deg": percentile(rotations_deg, 50.0),
        "p95_rotation_error_deg": percentile(rotations_deg, 95.0),
    }
