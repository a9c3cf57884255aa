"""Evaluation of loop closures: a table of all candidates, each compared with the truth, and its figures."""

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import betaincinv, expit

from logs.closures import find_final_decisions
from slam.common.geometry import invert, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.metrics.statistics import CONFIDENCE, fraction, percentile
from slam.evaluation.place_recognition.revisits import count_stages

EDGES = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999, 1.0)
"""Probabilities between the bins, and both ends."""
_COLUMNS = {
    "record": object,
    "query": np.int64,
    "stamp_ns": np.int64,
    "reference_stamp_ns": np.int64,
    "accepted": np.bool_,
    "stage": object,
    "seed": np.float64,
    "log_odds": np.float64,
}
"""Of the table of candidates, what is copied from their records."""


def judge_closures(records: EvaluationRecords, protocol: Protocol) -> pd.DataFrame | None:
    """Compare the final decision on each candidate with the relative pose that the truth gives its keyframes.

    A candidate is right if its transform is within ``closure_translation_m`` and ``closure_rotation_deg``, both
    inclusive, of the true one. Without a transform, or without truth at one of the stamps, it is undecided.

    Args:
        records: of the log; there may be no candidate, and no truth.
        protocol: the thresholds.

    Returns:
        A row a candidate, by query stamp: the ``record``; of it ``query`` (id), ``stamp_ns``, ``reference_stamp_ns``,
        ``accepted``, ``stage``, ``seed`` (id) and ``log_odds``, NaN where it has none; ``decided``, ``true`` (false
        where undecided); errors of where it puts the query keyframe, NaN where undecided: ``error_m``,
        ``rotation_rad``; ``travelled_m``: true path up to the query keyframe. None without a candidate where it is not
        known either that there should be one.
    """
    truth = records.true_path
    if not records.closures and (records.graph is None or not truth):
        return None
    candidates = find_final_decisions(records.closures)
    rows = [
        (c, c.query_keyframe_id, c.stamp_ns, c.reference_stamp_ns, c.accepted, c.stage, c.seed_query_keyframe_id,
         c.posterior_log_odds)
        for c in candidates
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=list(_COLUMNS)).astype(_COLUMNS)
    query_ns, reference_ns = table["stamp_ns"].to_numpy(), table["reference_stamp_ns"].to_numpy()
    T_world_query, unknown = truth.poses_at(query_ns), np.full((4, 4), np.nan)
    T_reference_query = [unknown if c.T_reference_query is None else c.T_reference_query for c in candidates]
    T_world_claimed = truth.poses_at(reference_ns) @ np.array(T_reference_query).reshape(-1, 4, 4)
    error_m = np.linalg.norm(T_world_claimed[:, :3, 3] - T_world_query[:, :3, 3], axis=1)
    rotation_rad = rotation_angle_rad(invert(T_world_query) @ T_world_claimed)
    return table.assign(
        decided=~np.isnan(error_m),
        true=protocol.is_true(error_m, rotation_rad),
        error_m=error_m,
        rotation_rad=rotation_rad,
        travelled_m=truth.travelled_at_m(query_ns),
    )


def describe_closures(judged: pd.DataFrame, protocol: Protocol) -> dict[str, Any]:
    """Counts, precision, errors, discoveries and reliability of the candidates of a drive, by the keys of the JSON.

    Args:
        judged: as :func:`judge_closures` returns them.
        protocol: the thresholds.
    """
    accepted = judged[judged["accepted"]]
    true = accepted[accepted["true"]]
    decided_count, rotations_deg = accepted["decided"].sum(), np.rad2deg(true["rotation_rad"])
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


def describe_discoveries(accepted: pd.DataFrame, protocol: Protocol) -> dict[str, Any]:
    """Accepted closures by their origin, and independent discoveries: found closures that have no objects in common.

    A closure that retrieval found is a discovery; those that it predicts for the keyframes after it and before it are
    checks of the same discovery. So a precision is as sure as its discoveries are many. The independent ones are runs
    of found closures that the truth decides; a run ends where the next query is a submap's length further on.
    ``proposer_counts``: accepted closures by what proposed their place.

    Args:
        accepted: rows of :func:`slam.evaluation.place_recognition.closures.judge_closures`.
        protocol: the thresholds.
    """
    is_found = accepted["seed"].isna()
    found = accepted[is_found & accepted["decided"]].sort_values("travelled_m", kind="stable")
    runs = (np.diff(found["travelled_m"], prepend=-np.inf) >= protocol.window_m).cumsum()
    independent, independent_false = len(np.unique(runs)), len(np.unique(runs[~found["true"]]))
    proposers = Counter(record.proposer for record in accepted["record"] if record.proposer)
    return {
        "found_count": is_found.sum(),
        "followed_count": (accepted["seed"] < accepted["query"]).sum(),
        "led_back_count": (accepted["seed"] >= accepted["query"]).sum(),
        "independent_count": independent,
        "independent_false_count": independent_false,
        "proposer_counts": {"descriptor": 0, **dict(sorted(proposers.items()))} if proposers else {},
        "largest_false_share": largest_false_share(independent, independent_false),
    }


def largest_false_share(count: int, false_count: int) -> float | None:
    """No more than that share of discoveries is false, with 95 % confidence (Clopper and Pearson, Biometrika 1934).

    About 3 / n where none of n is false: the rule of three. None without a discovery.
    """
    if count == 0 or count == false_count:
        return 1.0 if count else None
    return float(betaincinv(false_count + 1, count - false_count, CONFIDENCE))


def describe_reliability(judged: pd.DataFrame) -> dict[str, Any]:
    """Reliability of the posterior probabilities of places: a reliability diagram in numbers.

    Of each query the likeliest candidate has posterior odds against "somewhere new". If they are calibrated, of all
    that have the probability p a share p is right (DeGroot and Fienberg, The Statistician 1983). Counted are those
    candidates with posterior odds which no other closure predicted and which the truth decides.

    ``bins``: number, mean probability (None without any) and number of right ones between two ``EDGES``;
    ``sure_count``, ``sure_right``: candidates with a probability of at least 0.99.

    Args:
        judged: rows of :func:`slam.evaluation.place_recognition.closures.judge_closures`.
    """
    chosen = judged[judged["decided"] & judged["log_odds"].notna() & judged["seed"].isna()]
    probabilities, is_right = expit(chosen["log_odds"]), chosen["true"]
    bins = []
    for low, high in pairwise(EDGES):
        inside = (probabilities >= low) & ((probabilities < high) | (high == EDGES[-1]))
        expected, right = probabilities[inside].mean(), is_right[inside].sum()
        bins.append({"from": low, "to": high, "count": inside.sum(), "expected": expected, "right": right})
    sure = probabilities >= 0.99
    return {"bins": bins, "sure_count": sure.sum(), "sure_right": is_right[sure].sum()}
