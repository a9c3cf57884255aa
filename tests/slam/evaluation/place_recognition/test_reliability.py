"""Posterior probabilities against how often they are right."""

from dataclasses import replace
from typing import Any

import pytest
from scipy.special import logit

from logs.messages import LoopClosureRecord
from tests.slam.evaluation.loops import closure, judge, there_and_back

TRUTH = there_and_back()


def candidate(
    query: int, probability: float | None, *, is_right: bool = True, seed: int | None = None
) -> LoopClosureRecord:
    found = closure(query, 240 - query, truth=TRUTH, shift_m=0.0 if is_right else 9.0, stage="acceptance", seed=seed)
    odds = None if probability is None else float(logit(probability))
    return replace(found, posterior_log_odds=odds)


def reliability(*records: LoopClosureRecord) -> dict[str, Any]:
    return dict(judge(list(records), TRUTH)["reliability"])


def test_candidates_are_counted_by_their_probability_unless_they_were_propagated():
    left_out = candidate(192, 0.999, seed=189), candidate(202, None)
    found = reliability(candidate(190, 0.6), candidate(200, 0.8, is_right=False), candidate(210, 0.9995), *left_out)
    bins = {each["from"]: each for each in found["bins"]}
    assert sum(each["count"] for each in bins.values()) == 3
    assert (bins[0.5]["count"], bins[0.5]["right"]) == (2, 1)
    assert bins[0.5]["expected"] == pytest.approx(0.7)
    assert (bins[0.999]["count"], bins[0.999]["right"]) == (1, 1)
    assert (found["sure_count"], found["sure_right"]) == (1, 1)
    assert bins[0.0]["expected"] is None
