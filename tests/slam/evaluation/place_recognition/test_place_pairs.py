"""The protocols of papers, against counting every pair and every query, and against scikit-learn."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from sklearn.metrics import average_precision_score, precision_recall_curve

from logs.messages import FactorGraphRecord, LoopClosureRecord
from slam.common.arrays import IntArray
from slam.common.geometry import invert, transform_from_xyz_yaw
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.place_recognition.place_pairs import (
    ComparedKeyframes,
    OnlineQuality,
    PairQuality,
    compare_keyframes,
    evaluate_online,
    evaluate_pairs,
    number_frames,
)
from tests.slam.evaluation.drives import straight_path
from tests.slam.evaluation.loops import at_ns, closure, series_of, there_and_back
from tests.slam.evaluation.results import graph

TRUTH = there_and_back()
GRAPH = graph(TRUTH.stamps_ns, TRUTH.T_world_body)  # a keyframe a second and a metre, its id the index of the pose
NO_STAMPS = np.zeros(0, dtype=np.int64)


def compare(
    records: list[LoopClosureRecord],
    *,
    keyframes: FactorGraphRecord = GRAPH,
    truth: PoseSeries = TRUTH,
    odometry_stamps_ns: IntArray = NO_STAMPS,
) -> ComparedKeyframes:
    return compare_keyframes(records, keyframes, odometry_stamps_ns, truth, Protocol())


def pairs_of(records: list[LoopClosureRecord]) -> PairQuality:
    return evaluate_pairs(compare(records), Protocol())


def online_of(records: list[LoopClosureRecord]) -> OnlineQuality:
    return evaluate_online(compare(records), Protocol())


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
    distances = {
        earlier: float(np.linalg.norm(claimed[:3, 3] - keyframes.T_map_body[earlier, :3, 3]))
        for earlier in range(record.query_keyframe_id)
    }
    return {earlier: distance for earlier, distance in distances.items() if distance < 3.0}


def labelled_pairs(records: list[LoopClosureRecord], keyframes: FactorGraphRecord) -> tuple[list[bool], list[float]]:
    """Label and score of every pair that counts, one by one."""
    scores: dict[tuple[int, int], float] = {}
    for record in records:
        for earlier in claims_by_hand(record, keyframes):
            pair = earlier, record.query_keyframe_id
            scores[pair] = max(scores.get(pair, -np.inf), record.score)
    lowest = min(scores.values(), default=0.0) - 1.0
    labels, ranked = [], []
    for earlier, later in combinations(range(241), 2):
        apart_m = float(np.linalg.norm(TRUTH.positions[earlier] - TRUTH.positions[later]))
        is_positive = apart_m < 3.0 and later - earlier > 50
        if is_positive or apart_m > 20.0:
            labels.append(is_positive)
            ranked.append(scores.get((earlier, later), lowest))
    return labels, ranked


@pytest.mark.parametrize("keyframes", [GRAPH, drifting_graph()])
def test_pairs_agree_with_scikit_learn_over_every_pair(keyframes: FactorGraphRecord) -> None:
    records = noisy_candidates()
    found = evaluate_pairs(compare(records, keyframes=keyframes), Protocol())
    labels, scores = labelled_pairs(records, keyframes)
    assert (found.positive_count, found.negative_count) == (sum(labels), len(labels) - sum(labels))
    assert 20 < found.claimed_positive_count < found.positive_count
    assert found.claimed_negative_count > 20
    assert found.sweep.average_precision == pytest.approx(average_precision_score(labels, scores), abs=1e-12)
    precision, recall, thresholds = precision_recall_curve(labels, scores)
    np.testing.assert_allclose(found.sweep.thresholds[:-1], thresholds[:0:-1])
    assert found.sweep.thresholds[-1] == -np.inf
    np.testing.assert_allclose(found.sweep.precision, precision[-2::-1], atol=1e-12)
    np.testing.assert_allclose(found.sweep.recall, recall[-2::-1], atol=1e-12)


@pytest.mark.parametrize("keyframes", [GRAPH, drifting_graph()])
def test_online_agrees_with_answering_query_by_query(keyframes: FactorGraphRecord) -> None:
    records = noisy_candidates(seed=1)
    found = evaluate_online(compare(records, keyframes=keyframes), Protocol())
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
    assert (found.query_count, found.revisit_count, found.found_count) == (190, revisits, hits)
    assert found.recall_at_1 == hits / revisits
    assert 20 < hits < revisits
    assert not all(labels)
    expected = average_precision_score(labels, scores) * sum(labels) / revisits
    assert found.sweep.average_precision == pytest.approx(expected, abs=1e-12)


def test_frames_are_numbered_by_odometry() -> None:
    assert number_frames(np.array([30, 10, 20]), NO_STAMPS).tolist() == [2, 0, 1]
    assert number_frames(np.array([30, 10, 20]), np.arange(0, 40, 5)).tolist() == [6, 2, 4]
    # With ten messages a keyframe all but the neighbours are more than 50 frames apart, from the turn on.
    often = at_ns(0) + np.arange(2410) * 100_000_000
    by_keyframes, by_messages = (
        evaluate_pairs(compare([], odometry_stamps_ns=stamps), Protocol()) for stamps in (NO_STAMPS, often)
    )
    assert by_messages.positive_count > by_keyframes.positive_count
    assert by_messages.negative_count == by_keyframes.negative_count
    assert by_messages.sweep is None


@pytest.mark.parametrize("records", [[], [closure(190, 50)], [closure(190, 60, truth=TRUTH, shift_m=4.0)]])
def test_nothing_claimed_is_undefined_and_finds_nothing(records: list[LoopClosureRecord]) -> None:
    """No candidate, one without a transform, and one that puts the query 6 m from any keyframe before."""
    off_the_road = transform_from_xyz_yaw(np.array([0.0, 6.0, 0.0]), 0.0)
    moved = [
        r if r.T_reference_query is None else replace(r, T_reference_query=off_the_road @ r.T_reference_query)
        for r in records
    ]
    pairs, online = pairs_of(moved), online_of(moved)
    assert pairs.sweep is None
    assert (online.found_count, online.recall_at_1) == (0, 0.0)
    assert online.sweep.average_precision is online.sweep.extended_precision is None


def test_no_revisit() -> None:
    straight = series_of(straight_path(200))
    keyframes = graph(straight.stamps_ns, straight.T_world_body)
    compared = compare([closure(150, 20, truth=straight, shift_m=9.0)], keyframes=keyframes, truth=straight)
    pairs, online = evaluate_pairs(compared, Protocol()), evaluate_online(compared, Protocol())
    assert (pairs.positive_count, pairs.sweep) == (0, None)
    assert (online.revisit_count, online.recall_at_1, online.sweep) == (0, None, None)


def test_no_truth_and_one_keyframe() -> None:
    none, one = series_of(np.zeros((0, 4, 4))), series_of(np.eye(4)[None])
    for truth in (none, one):
        compared = compare([closure(190, 50, truth=TRUTH)], truth=truth)
        pairs, online = evaluate_pairs(compared, Protocol()), evaluate_online(compared, Protocol())
        assert (pairs.positive_count, pairs.negative_count, pairs.sweep) == (0, 0, None)
        assert (online.query_count, online.revisit_count) == (0, 0)


def test_candidates_of_unknown_keyframes_are_left_out() -> None:
    stranger = replace(closure(190, 50, truth=TRUTH), query_keyframe_id=999)
    from_nowhere = replace(closure(190, 50, truth=TRUTH), reference_keyframe_id=-1)
    assert len(compare([stranger, from_nowhere]).query_rows) == 0


def test_a_score_that_is_no_number_is_the_lowest() -> None:
    wrong = closure(190, 90, truth=TRUTH, shift_m=0.0, score=float("nan"))
    far = transform_from_xyz_yaw(np.array([-40.0, 0.0, 0.0]), 0.0)
    assert wrong.T_reference_query is not None
    wrong = replace(wrong, T_reference_query=invert(far) @ wrong.T_reference_query)
    records = [wrong, closure(190, 50, truth=TRUTH, score=-5.0)]
    assert online_of(records).found_count == 1
    sweep = pairs_of(records).sweep
    assert sweep.thresholds.tolist() == [-5.0, -np.inf]
    assert sweep.precision[0] == 1.0
