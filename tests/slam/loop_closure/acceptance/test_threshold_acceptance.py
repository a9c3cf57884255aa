"""Acceptance by thresholds: one candidate, rivals, patterns that repeat, and candidates that wait for others."""

from __future__ import annotations

import pytest

from slam.common.config import LoopClosureConfig
from slam.loop_closure.acceptance.threshold_acceptance import ThresholdAcceptance
from slam.loop_closure.candidate import Candidate, Query
from tests.helpers.candidates import make_candidate
from tests.slam.loop_closure.doubles import Patterns, at, make_keyframe, make_query

LIMITS = LoopClosureConfig()
STEP_M = 2.0


def candidate(x_m: float, llr: float, *, query: int = 50, row: int = 0, penalty: float = 0.0) -> Candidate:
    return make_candidate(
        query=query,
        travel_m=STEP_M * query,
        T_local_query=at(x_m),
        llrs={row: llr},
        odometry_penalty=penalty,
        T_reference_query=at(0.0),
    )


def query(number: int = 50) -> Query:
    return make_query(make_keyframe(number, STEP_M * number))


@pytest.fixture
def patterns() -> Patterns:
    return Patterns()


@pytest.fixture
def acceptance(patterns: Patterns) -> ThresholdAcceptance:
    keyframes = [make_keyframe(number, STEP_M * number) for number in range(100)]
    return ThresholdAcceptance(LIMITS, patterns, keyframes)  # type: ignore[arg-type]


def test_a_score_that_suffices_is_accepted_alone(acceptance):
    assert acceptance.min_objects == LIMITS.min_inliers
    assert acceptance.is_acceptable(candidate(0.0, LIMITS.accept_llr))
    decision = acceptance.decide(query(), [candidate(0.0, LIMITS.accept_llr)])
    assert decision.accepted is not None
    assert (decision.reason, decision.supporting, decision.rejected) == ("", (), ())


@pytest.mark.parametrize(("llr", "penalty"), [(LIMITS.accept_llr - 0.1, 0.0), (LIMITS.accept_llr + 4.9, 5.0)])
def test_a_score_that_does_not_suffice_waits(acceptance, llr, penalty):
    weak = candidate(0.0, llr, penalty=penalty)
    assert not acceptance.is_acceptable(weak)
    decision = acceptance.decide(query(), [weak])
    assert decision.accepted is None
    assert [record.stage for record in decision.rejected] == ["consistency"]
    assert "accept_llr is 20" in decision.rejected[0].reason
    assert decision.contradicts_odometry is (penalty > 0.0)


def test_a_rival_leaves_it_open_unless_both_can_be_true(acceptance, patterns):
    both = [candidate(0.0, 30.0), candidate(200.0, 30.0 - LIMITS.ambiguity_margin + 0.1)]
    decision = acceptance.decide(query(), both)
    assert decision.accepted is None
    assert "ambiguous: score 30.0, second best 25.1" in decision.rejected[-1].reason
    clear = [candidate(0.0, 30.0), candidate(200.0, 30.0 - LIMITS.ambiguity_margin - 0.1)]
    assert acceptance.decide(query(), clear).accepted.best_rival_llr == pytest.approx(24.9)
    patterns.passed_twice = True
    assert acceptance.decide(query(), both).accepted is not None


@pytest.mark.parametrize(("where", "told"), [("along_track", "along track"), ("repeated", "pattern")])
def test_a_pattern_that_repeats_itself_leaves_it_open(acceptance, patterns, where, told):
    setattr(patterns, where, [candidate(8.0, 25.1)])
    decision = acceptance.decide(query(), [candidate(0.0, 30.0)])
    assert decision.accepted is None
    assert f"ambiguous {told}" in decision.rejected[0].reason
    setattr(patterns, where, [candidate(8.0, 24.9)])
    assert acceptance.decide(query(), [candidate(0.0, 30.0)]).accepted is not None


def test_what_is_tracked_needs_evidence_but_not_the_odometry(acceptance):
    least = LIMITS.accept_llr_tracked
    assert acceptance.is_confirmed(candidate(0.0, least, penalty=15.0))
    assert not acceptance.is_confirmed(candidate(0.0, least - 0.1))


def test_candidates_that_the_odometry_carries_to_one_another_are_accepted_together(acceptance):
    acceptance.decide(query(50), [candidate(300.0, 12.0, query=50, row=1)])
    decision = acceptance.decide(query(55), [candidate(310.0, 12.0, query=55, row=2)])
    assert decision.accepted is not None
    assert decision.reason == "accumulated score 24.0 with 1 other keyframes"
    assert [each.query for each in decision.supporting] == [50]
    assert decision.accepted.accumulated_llr == decision.supporting[0].accumulated_llr == pytest.approx(24.0)
    # The one that waited was used up.
    later = acceptance.decide(query(56), [candidate(312.0, 12.0, query=56, row=3)])
    assert later.accepted is None


@pytest.mark.parametrize("x_m", [300.0, 330.0])
def test_candidates_that_do_not_agree_do_not_support_one_another(acceptance, x_m):
    acceptance.decide(query(50), [candidate(300.0, 12.0, query=50, row=1)])
    assert acceptance.decide(query(55), [candidate(x_m, 12.0, query=55, row=2)]).accepted is None


def test_what_is_worth_little_does_not_wait(acceptance):
    for number in range(50, 56):
        weak = candidate(STEP_M * number, LIMITS.hypothesis_llr - 0.1, query=number, row=number)
        decision = acceptance.decide(query(number), [weak])
        assert decision.accepted is None
        assert "hypothesis_llr is 10" in decision.rejected[0].reason


@pytest.mark.parametrize("where", ["along_track", "repeated"])
def test_several_keyframes_can_be_ambiguous_together(acceptance, patterns, where):
    acceptance.decide(query(50), [candidate(300.0, 12.0, query=50, row=1)])
    setattr(patterns, where, [candidate(318.0, 11.0)])
    decision = acceptance.decide(query(55), [candidate(310.0, 12.0, query=55, row=2)])
    assert decision.accepted is None
    assert "ambiguous" in decision.rejected[-1].reason


def test_what_waits_is_forgotten_after_a_while_and_by_a_reset(acceptance):
    later = 50 + int(LIMITS.propagation_distance_m / STEP_M) + 1
    acceptance.decide(query(50), [candidate(300.0, 12.0, query=50, row=1)])
    x_m = 300.0 + STEP_M * (later - 50)
    assert acceptance.decide(query(later), [candidate(x_m, 12.0, query=later, row=2)]).accepted is None
    acceptance.reset()
    assert acceptance.expected_places(query(later)) == []
    again = candidate(x_m + STEP_M, 12.0, query=later + 1, row=3)
    assert acceptance.decide(query(later + 1), [again]).accepted is None
