from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam.evaluation.closure_sweep import ScoreSweep, sweep_scores

Candidate = tuple[int, float, bool]


def sweep(candidates: list[Candidate], revisit_ids: list[int]) -> ScoreSweep | None:
    return sweep_scores(
        np.array([c[0] for c in candidates], dtype=np.int64),
        np.array([c[1] for c in candidates], dtype=np.float64),
        np.array([c[2] for c in candidates], dtype=np.bool_),
        revisit_ids=np.array(revisit_ids, dtype=np.int64),
    )


def brute_force(candidates: list[Candidate], revisit_ids: list[int]) -> list[tuple[float, float, float]]:
    """(threshold, precision, recall) of every threshold, by accepting and counting anew at each."""
    best: dict[int, tuple[float, bool]] = {}
    for query, score, is_true in candidates:
        at_top, was_true = best.get(query, (-np.inf, True))
        if score > at_top:
            best[query] = score, is_true
        elif score == at_top:
            best[query] = score, is_true and was_true
    points = []
    for threshold in sorted({score for score, _ in best.values()}, reverse=True):
        accepted = {query: is_true for query, (score, is_true) in best.items() if score >= threshold}
        recalled = [query for query, is_true in accepted.items() if is_true and query in revisit_ids]
        points.append((threshold, sum(accepted.values()) / len(accepted), len(recalled) / len(revisit_ids)))
    return points


# Few scores, so that many are equal.
@given(
    st.lists(st.tuples(st.integers(0, 8), st.sampled_from([0.0, 0.5, 1.0, 2.0]), st.booleans()), max_size=40),
    st.lists(st.integers(0, 9), min_size=1, max_size=10, unique=True),
)
def test_against_counting_at_every_threshold(candidates: list[Candidate], revisit_ids: list[int]) -> None:
    found = sweep(candidates, revisit_ids)
    assert found is not None
    expected = brute_force(candidates, revisit_ids)
    curve = np.column_stack([found.thresholds, found.precision, found.recall])
    np.testing.assert_allclose(curve, np.array(expected).reshape(-1, 3))
    before = np.array([0.0, *(recall for _, _, recall in expected)])
    average = sum((recall - b) * precision for (_, precision, recall), b in zip(expected, before[:-1], strict=True))
    assert found.average_precision == pytest.approx(average)
    assert found.f1_max == pytest.approx(max([0.0, *(2 * p * r / (p + r) for _, p, r in expected if p + r > 0)]))
    assert found.recall_at_full_precision == max([0.0, *(r for _, p, r in expected if p == 1.0)])


def test_numbers_by_hand() -> None:
    # Query 4 is no revisit; the revisit 5 was never found.
    found = sweep([(1, 9.0, True), (1, 1.0, False), (2, 8.0, True), (3, 7.0, False), (4, 6.0, True)], [1, 2, 3, 5])
    assert found is not None
    assert found.precision.tolist() == [1.0, 1.0, 2 / 3, 3 / 4]
    assert found.recall.tolist() == [0.25, 0.5, 0.5, 0.5]
    assert found.average_precision == 0.5
    assert found.recall_at_full_precision == 0.5
    assert found.f1_max == pytest.approx(2 / 3)


def test_equal_scores_are_accepted_together() -> None:
    for order in ([0, 1], [1, 0]):
        across = [(1, 5.0, True), (2, 5.0, False)]
        found = sweep([across[i] for i in order], [1, 2])
        assert found is not None
        assert (found.precision.tolist(), found.recall.tolist()) == ([0.5], [0.5])
        within = [(1, 5.0, True), (1, 5.0, False)]
        found = sweep([within[i] for i in order], [1])
        assert found is not None
        assert (found.precision.tolist(), found.recall.tolist()) == ([0.0], [0.0])


def test_a_score_that_is_no_number_comes_last() -> None:
    found = sweep([(1, float("nan"), False), (2, 0.0, True)], [1, 2])
    assert found is not None
    assert found.precision.tolist() == [1.0, 0.5]
    assert found.recall_at_full_precision == 0.5


def test_without_candidates_or_revisits() -> None:
    found = sweep([], [1])
    assert found is not None
    assert len(found.thresholds) == 0
    assert (found.average_precision, found.f1_max, found.recall_at_full_precision) == (0.0, 0.0, 0.0)
    assert sweep([(1, 1.0, True)], []) is None
