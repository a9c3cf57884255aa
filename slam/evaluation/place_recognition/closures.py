"""How good loop closures are: a table of all candidates, each judged by the truth, and the figures made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from logs.messages import LoopClosureRecord
from slam.common.geometry import invert, rotation_angle_rad, yaw_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.statistics import fraction, percentile
from slam.evaluation.place_recognition.discoveries import describe_discoveries
from slam.evaluation.place_recognition.reliability import describe_reliability
from slam.evaluation.place_recognition.revisits import count_stages, find_true_poses

_DECIDED_FROM = (
    *("query_keyframe_id", "reference_keyframe_id", "seed_query_keyframe_id", "represented_by_keyframe_id"),
    *("accepted", "inserted", "stage", "score", "log_likelihood_ratio", "odometry_penalty"),
    *("posterior_log_odds", "best_rival_log_likelihood_ratio"),
)


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
        A row a candidate: the ``record``; of it ``query``, ``reference`` (ids), ``stamp_ns``, ``reference_stamp_ns`` (0
        if unknown), ``accepted``, ``stage``, ``score``; ``decided``, ``true`` (false where undecided), ``same_place``
        (the two keyframes are near each other, with or without a transform); errors of where it puts the query
        keyframe, 0 where undecided: ``x_m``, ``y_m``, ``z_m`` (world frame), ``error_m``, ``rotation_rad``, and in the
        plane of the query's body ``planar_m``, ``heading_rad``; ``travelled_m``: true path up to the query keyframe.
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
    T_reference_query = [np.eye(4) if c.T_reference_query is None else c.T_reference_query for c in candidates]
    decided = comparable & registered
    T_world_claimed = T_world_reference @ np.array(T_reference_query).reshape(-1, 4, 4)
    offsets = T_world_claimed[:, :3, 3] - T_world_query[:, :3, 3]
    T_query_claimed = invert(T_world_query) @ T_world_claimed
    errors = {
        **dict(zip(("x_m", "y_m", "z_m"), offsets.T, strict=True)),
        "error_m": np.linalg.norm(offsets, axis=1),
        "rotation_rad": rotation_angle_rad(T_query_claimed),
        "planar_m": np.hypot(T_query_claimed[:, 0, 3], T_query_claimed[:, 1, 3]),
        "heading_rad": yaw_rad(T_query_claimed),
    }
    near = errors["error_m"] <= protocol.closure_translation_m
    turned_alike = errors["rotation_rad"] <= np.deg2rad(protocol.closure_rotation_deg)
    apart_m = np.linalg.norm(T_world_query[:, :3, 3] - T_world_reference[:, :3, 3], axis=1)
    return pd.DataFrame(
        {
            "record": pd.Series(candidates, dtype=object),
            "query": np.array([c.query_keyframe_id for c in candidates], dtype=np.int64),
            "reference": np.array([c.reference_keyframe_id for c in candidates], dtype=np.int64),
            "stamp_ns": query_ns,
            "reference_stamp_ns": reference_ns,
            "accepted": np.array([c.accepted for c in candidates], dtype=np.bool_),
            "stage": pd.Series([c.stage for c in candidates], dtype=object),
            "score": np.array([c.score for c in candidates], dtype=np.float64),
            "decided": decided,
            "true": decided & near & turned_alike,
            "same_place": comparable & (apart_m <= protocol.revisit_distance_m),
            **{name: np.where(decided, error, 0.0) for name, error in errors.items()},
            "travelled_m": truth.travelled_at_m(query_ns) if len(truth) else np.zeros(count),
        }
    )


def describe_closures(judged: pd.DataFrame, protocol: Protocol, *, has_truth: bool) -> dict[str, Any]:
    """Counts, precision, errors, discoveries and reliability of the candidates of a drive, by the keys of the JSON.

    Args:
        judged: as :func:`judge_closures` returns them.
        protocol: the thresholds.
        has_truth: without a truth only counts are defined.
    """
    accepted = judged[judged["accepted"]]
    right, undecided = int(accepted["true"].sum()), int((~accepted["decided"]).sum())
    wrong = len(accepted) - right - undecided
    return {
        "candidate_count": len(judged),
        "accepted_count": len(accepted),
        "inserted_count": sum(record.inserted for record in judged["record"]),
        "true_count": right if has_truth else None,
        "false_count": wrong if has_truth else None,
        "undecided_count": undecided if has_truth else None,
        "precision": fraction(right, right + wrong),
        "stage_counts": count_stages(judged["stage"]),
        **describe_discoveries(accepted, protocol, has_truth=has_truth),
        "reliability": describe_reliability(judged if has_truth else None),
        **_describe_errors(accepted[accepted["true"]], protocol.closure_run_gap_m),
        "verified_candidates": _list_verified(judged),
    }


def _describe_errors(true: pd.DataFrame, run_gap_m: float) -> dict[str, float | None]:
    """Errors of the accepted true closures; planar ones too, as some truths drift in height, that of KITTI among them.

    ``intra_revisit_std_m``: median over runs of at least two closures of the RMS distance of the error vectors from
    their mean; a run ends where the path grows by ``run_gap_m`` or more.
    """
    runs = (np.diff(true["travelled_m"], prepend=-np.inf) >= run_gap_m).cumsum()
    vectors = true[["x_m", "y_m", "z_m"]].groupby(runs)
    spreads = np.sqrt(vectors.var(ddof=0).sum(axis=1))[vectors.size() > 1]
    rotations_deg = np.rad2deg(true["rotation_rad"])
    return {
        "median_translation_error_m": percentile(true["error_m"], 50.0),
        "p95_translation_error_m": percentile(true["error_m"], 95.0),
        "median_planar_error_m": percentile(true["planar_m"], 50.0),
        "median_heading_error_deg": percentile(np.rad2deg(true["heading_rad"].abs()), 50.0),
        "median_rotation_error_deg": percentile(rotations_deg, 50.0),
        "p95_rotation_error_deg": percentile(rotations_deg, 95.0),
        "intra_revisit_std_m": percentile(spreads, 50.0),
    }


def _list_verified(judged: pd.DataFrame) -> list[dict[str, Any]]:
    """What each candidate with a log-likelihood ratio was decided from, and whether it is true: None if undecided."""
    return [
        {name: getattr(record, name) for name in _DECIDED_FROM} | {"true": bool(true) if decided else None}
        for record, decided, true in zip(judged["record"], judged["decided"], judged["true"], strict=True)
        if record.log_likelihood_ratio is not None
    ]
