"""The online protocol of papers, against answering every query by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sklearn.metrics import average_precision_score

from logs.messages import FactorGraphRecord, LoopClosureRecord
from slam.common.geometry import invert, transform_from_xyz_yaw
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.place_recognition.online_protocol import evaluate_online, number_frames
from tests.slam.evaluation.drives import straight_path
from tests.slam.evaluation.loops import at_ns, closure, series_of, there_and_back
from tests.slam.evaluation.results import graph

TRUTH = there_and_back()
GRAPH = graph(TRUTH.stamps_ns, TRUTH.T_world_body)  # a keyframe a second and a metre, its id the index of the pose
NO_STAMPS = np.zeros(0, dtype=np.int64)


def online_of(
    records: list[LoopClosureRecord], keyframes: FactorGraphRecord = GRAPH, truth: PoseSeries = TRUTH
) -> dict[str, Any]:
    return evaluate_online(records, keyframes, NO_STAMPS, truth, Protocol())


def noisy_candidates(seed: int = 0) -> list[LoopClosureRecord]:
    """Of most keyframes of the way back up to three candidates, right and wrong ones, many scores equal."""
    rng = np.random.default_rng(seed)
    records = []
    for query in range(125, 241):
        for _ in range(rng.integers(0, 4)):
            reference = int(np.clip(240 - query + rng.integers(-8, 9), 0, 120))
            shift_m = float(rng.choice([0.0, 0.5, 2.0, 6.0, 40.0], p=[0.3, 0.3, 0.1, 0.1, 0.2]))
            score = float(rng.integers(0, 12)) - 4.0 * (shift_m > 5.0)
            records.append(closure(query, reference, truth=TRUTH, shift_m=shift_m, score=score, stage="acceptance"))
    return records


def drifting_graph() -> FactorGraphRecord:
    """The same drive as a map has it that is bent and lies elsewhere."""
    index = np.arange(241)
    xyz = np.column_stack([0.002 * index**1.5, 0.004 * index, np.zeros(241)])
    T_world_map = transform_from_xyz_yaw(np.array([5.0, 6.0, 7.0]), 0.4)
    return graph(TRUTH.stamps_ns, T_world_map @ transform_from_xyz_yaw(xyz, 1e-4 * index) @ TRUTH.T_world_body)


def claims_by_hand(record: LoopClosureRecord, keyframes: FactorGraphRecord) -> dict[int, float]:
    """Earlier keyframe -> distance, of those that a candidate puts less than 3 m from its query."""
    assert record.T_reference_query is not None
    claimed = keyframes.T_map_body[record.reference_keyframe_id] @ record.T_reference_query
    distances = np.linalg.norm(keyframes.T_map_body[: record.query_keyframe_id, :3, 3] - claimed[:3, 3], axis=1)
    return {earlier: distance for earlier, distance in enumerate(distances.tolist()) if distance < 3.0}


@pytest.mark.parametrize("keyframes", [GRAPH, drifting_graph()])
def test_online_agrees_with_answering_query_by_query(keyframes: FactorGraphRecord) -> None:
    records = noisy_candidates(seed=1)
    found = online_of(records, keyframes)
    positions = TRUTH.positions
    labels, scores, revisits, hits = [], [], 0, 0
    for query in range(51, 241):
        before = positions[: query - 50]
        is_revisit = bool((np.linalg.norm(before - positions[query], axis=1) < 3.0).any())
        revisits += is_revisit
        of_query = [r for r in records if r.query_keyframe_id == query]
        best = max((r.score for r in of_query), default=0.0)
        answers = []
        for record in of_query:
            claims = {e: d for e, d in claims_by_hand(record, keyframes).items() if query - e > 50}
            if record.score == best and claims:
                answers.append(min(claims, key=lambda e: claims[e]))
        if answers:
            is_right = all(np.linalg.norm(positions[answer] - positions[query]) < 3.0 for answer in answers)
            labels.append(is_right)
            scores.append(best)
            hits += is_right and is_revisit
    assert (found["query_count"], found["revisit_count"], found["found_count"]) == (190, revisits, hits)
    assert found["recall_at_1"] == hits / revisits
    assert 20 < hits < revisits
    assert not all(labels)
    expected = average_precision_score(labels, scores) * sum(labels) / revisits
    assert found["average_precision"] == pytest.approx(expected, abs=1e-12)


def test_frames_are_numbered_by_odometry() -> None:
    assert number_frames(np.array([30, 10, 20]), NO_STAMPS).tolist() == [2, 0, 1]
    assert number_frames(np.array([30, 10, 20]), np.arange(0, 40, 5)).tolist() == [6, 2, 4]
    often = at_ns(0) + np.arange(2410) * 100_000_000
    by_messages = evaluate_online([], GRAPH, often, TRUTH, Protocol())
    assert by_messages["query_count"] > online_of([])["query_count"]


@pytest.mark.parametrize("records", [[], [closure(190, 50)], [closure(190, 60, truth=TRUTH, shift_m=4.0)]])
def test_candidates_without_answer_find_nothing(records: list[LoopClosureRecord]) -> None:
    """No candidate, one without a transform, and one that puts the query 6 m from any keyframe before."""
    off_the_road = transform_from_xyz_yaw(np.array([0.0, 6.0, 0.0]), 0.0)
    moved = [
        r if r.T_reference_query is None else replace(r, T_reference_query=off_the_road @ r.T_reference_query)
        for r in records
    ]
    found = online_of(moved)
    assert (found["found_count"], found["recall_at_1"], found["average_precision"]) == (0, 0.0, None)


def test_drives_without_revisit_or_truth_have_no_recall() -> None:
    straight = series_of(straight_path(200))
    keyframes = graph(straight.stamps_ns, straight.T_world_body)
    found = online_of([closure(150, 20, truth=straight, shift_m=9.0)], keyframes, straight)
    assert (found["revisit_count"], found["recall_at_1"], found["average_precision"]) == (0, None, None)
    for truth in (series_of(np.zeros((0, 4, 4))), series_of(np.eye(4)[None])):
        found = online_of([closure(190, 50, truth=TRUTH)], truth=truth)
        assert (found["query_count"], found["revisit_count"]) == (0, 0)


def test_candidates_of_unknown_keyframes_are_left_out() -> None:
    right = closure(190, 50, truth=TRUTH)
    assert online_of([right])["found_count"] == 1
    strangers = [replace(right, query_keyframe_id=999), replace(right, reference_keyframe_id=-1)]
    assert online_of(strangers)["found_count"] == 0


def test_score_that_is_no_number_is_the_lowest() -> None:
    wrong = closure(190, 90, truth=TRUTH, score=float("nan"))
    far = transform_from_xyz_yaw(np.array([-40.0, 0.0, 0.0]), 0.0)
    assert wrong.T_reference_query is not None
    wrong = replace(wrong, T_reference_query=invert(far) @ wrong.T_reference_query)
    assert online_of([wrong, closure(190, 50, truth=TRUTH, score=-5.0)])["found_count"] == 1
