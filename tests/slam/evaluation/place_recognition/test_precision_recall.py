from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.evaluation.place_recognition.revisits import describe_sweep, sweep_scores

Candidate = tuple[int, float, bool]


def sweep(candidates: list[Candidate], revisit_ids: list[int]) -> pd.DataFrame | None:
    return sweep_scores(
        np.array([c[0] for c in candidates], dtype=np.int64),
        np.array([c[1] for c in candidates], dtype=np.float64),
        np.array([c[2] for c in candidates], dtype=np.bool_),
        revisit_ids=np.array(revisit_ids, dtype=np.int64),
    )


def figures(candidates: list[Candidate], revisit_ids: list[int]) -> dict[str, Any]:
    return describe_sweep(sweep(candidates, revisit_ids))


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
@settings(max_examples=40)
@given(
    st.lists(st.tuples(st.integers(0, 8), st.sampled_from([0.0, 0.5, 1.0, 2.0]), st.booleans()), max_size=40),
    st.lists(st.integers(0, 9), min_size=1, max_size=10, unique=True),
)
def test_against_counting_at_every_threshold(candidates: list[Candidate], revisit_ids: list[int]) -> None:
    found = sweep(candidates, revisit_ids)
    expected = brute_force(candidates, revisit_ids)
    told = figures(candidates, revisit_ids)
    if not expected:
        assert told["average_precision"] is told["recall_at_full_precision"] is None
        return
    np.testing.assert_allclose(found.to_numpy(), np.array(expected).reshape(-1, 3))
    before = np.array([0.0, *(recall for _, _, recall in expected)])
    average = sum((recall - b) * precision for (_, precision, recall), b in zip(expected, before[:-1], strict=True))
    assert told["average_precision"] == pytest.approx(average)
    assert told["recall_at_full_precision"] == max([0.0, *(r for _, p, r in expected if p == 1.0)])


def test_a_score_that_is_no_number_comes_last() -> None:
    found = figures([(1, float("nan"), False), (2, 0.0, True)], [1, 2])
    assert found["precision_recall_curve"]["precision"] == [1.0, 0.5]
    assert found["recall_at_full_precision"] == 0.5
