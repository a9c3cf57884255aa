"""Posterior probabilities against how often they are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logit

from logs.messages import LoopClosureRecord
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.place_recognition.closures import evaluate_closures
from slam.evaluation.place_recognition.reliability import EDGES, Reliability
from tests.slam.evaluation.loops import at_ns, closure, there_and_back

TRUTH = there_and_back()


def candidate(
    query: int, probability: float | None, *, is_right: bool = True, seed: int | None = None
) -> LoopClosureRecord:
    found = closure(query, 240 - query, truth=TRUTH, shift_m=0.0 if is_right else 9.0, stage="acceptance", seed=seed)
    odds = None if probability is None else float(logit(probability))
    return replace(found, posterior_log_odds=odds)


def reliability(*records: LoopClosureRecord) -> Reliability:
    keyframes = np.arange(241)
    found = evaluate_closures(
        records, keyframes, np.array([at_ns(each) for each in range(241)]), TRUTH, Protocol()
    ).reliability
    assert found is not None
    return found


def test_candidates_are_counted_by_their_probability():
    found = reliability(candidate(190, 0.6), candidate(200, 0.8, is_right=False), candidate(210, 0.9995))
    middle, high = (int(np.searchsorted(EDGES, p)) for p in (0.7, 0.9995))
    assert found.counts.sum() == 3
    assert (found.counts[middle], found.right[middle]) == (2, 1)
    assert found.expected[middle] == pytest.approx(0.7)
    assert (found.counts[high], found.right[high]) == (1, 1)
    assert (found.sure_count, found.sure_right) == (1, 1)
    assert np.isnan(found.expected[0])


def test_reliability_leaves_out_propagated_closures():
    found = reliability(candidate(190, 0.999, seed=189), candidate(200, None), candidate(210, 0.995, is_right=False))
    assert found.counts.sum() == 1
    assert (found.sure_count, found.sure_right) == (1, 0)
