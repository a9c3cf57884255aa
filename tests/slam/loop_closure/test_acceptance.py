"""Acceptance by posterior probability: one candidate, rivals, patterns that repeat, and what is remembered."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logit

from logs.closures import Stage
from slam.common.config import Config, LocalizationConfig
from slam.loop_closure.acceptance import Acceptance, Decision, _posterior_log_odds
from slam.loop_closure.candidate import Candidate, Query
from tests.helpers.candidates import make_candidate
from tests.helpers.poses import pose_at
from tests.slam.loop_closure.doubles import Patterns, make_keyframe, make_query

PENALTY = 15.0
SURE_LLR = PENALTY - logit(LocalizationConfig().error_probability) + 0.5
"""A little more than the log odds that are wanted, above the penalty."""


def candidate(x_m: float, llr: float) -> Candidate:
    made = make_candidate(
        T_local_query=pose_at(x_m), llrs={0: llr}, odometry_penalty=PENALTY, T_reference_query=pose_at(0.0)
    )
    return replace(made, unpredicted_penalty=PENALTY + 10.0)


def query() -> Query:
    return make_query(make_keyframe(50, 300.0))


@pytest.fixture
def patterns() -> Patterns:
    return Patterns()


@pytest.fixture
def acceptance(patterns: Patterns) -> Acceptance:
    return Acceptance(Config(), patterns)  # type: ignore[arg-type]


@pytest.fixture
def decide(acceptance: Acceptance) -> Callable[..., Decision]:
    """What becomes of candidates of one query."""
    return lambda *verified: acceptance.decide(query(), list(verified))


def test_a_candidate_is_accepted_from_the_odds_on_that_are_wanted(decide, acceptance):
    for llr, is_wanted in ((SURE_LLR, True), (SURE_LLR - 1.0, False)):
        assert acceptance.is_acceptable(candidate(0.0, llr)) is is_wanted
        assert (decide(candidate(0.0, llr)).accepted is not None) is is_wanted
    refused = decide(candidate(0.0, SURE_LLR - 1.0))
    wrong = 1.0 / (1.0 + np.exp(SURE_LLR - 1.0 - PENALTY))
    assert refused.rejected[0].reason == f"wrong with probability {wrong:.2g}"


def test_a_place_that_the_odometry_rules_out_shows_that_places_are_alike(decide):
    elsewhere = replace(candidate(200.0, SURE_LLR + 15.0), odometry_penalty=PENALTY + 40.0)
    assert decide(candidate(0.0, SURE_LLR + 10.0), elsewhere).accepted is None
    by_chance = replace(elsewhere, unpredicted_penalty=SURE_LLR + 15.0)
    assert decide(candidate(0.0, SURE_LLR + 10.0), by_chance).accepted is not None


@pytest.mark.parametrize("is_proposed", [True, False])
def test_a_place_is_open_where_another_one_is_as_likely(decide, patterns, is_proposed):
    other = candidate(200.0, SURE_LLR + 9.9)
    patterns.alike = [] if is_proposed else [other]
    assert decide(candidate(0.0, SURE_LLR + 10.0), *([other] if is_proposed else [])).accepted is None


def test_posterior_odds_are_against_somewhere_new_and_all_others():
    first, second = candidate(0.0, 40.0), candidate(50.0, 38.0)
    assert _posterior_log_odds(first, []) == pytest.approx(40.0 - PENALTY)
    against_first = np.logaddexp(38.0 - PENALTY, 38.0 - PENALTY - 10.0)
    assert _posterior_log_odds(first, [second]) == pytest.approx(40.0 - PENALTY - against_first)


def test_a_place_unlike_all_others_may_be_new_where_others_are_alike():
    def odds(llr: float) -> float:
        other = replace(candidate(80.0, llr), odometry_penalty=30.0, unpredicted_penalty=25.0)
        return _posterior_log_odds(candidate(0.0, 48.0), [other])

    # By chance a pose in the area reaches an LLR of 25.
    assert odds(25.0) == pytest.approx(48.0 - PENALTY, abs=0.01)
    # What is new looks like the other place at 1 of exp(25) poses.
    assert odds(40.0) == pytest.approx(48.0 - PENALTY - np.logaddexp(40.0 - 25.0, 10.0))


def test_what_fits_but_not_with_the_prior_is_a_matter_of_consistency(decide):
    far = replace(candidate(0.0, 30.0), odometry_penalty=28.0)
    assert [each.stage for each in decide(far).rejected] == ["consistency"]
    assert [each.stage for each in decide(candidate(0.0, 4.0)).rejected] == ["acceptance"]


def test_candidates_that_agree_are_one_and_places_without_a_candidate_keep_their_reasons(decide):
    refused = query().refusal(Stage.REGISTRATION, "nothing fits")
    decision = decide(candidate(0.5, SURE_LLR), refused, candidate(0.0, SURE_LLR + 1.0))
    assert decision.accepted.T_local_query[0, 3] == 0.0
    assert decision.rejected == (refused,)
    assert decide(refused).rejected == (refused,)
