"""Whether the result of a drive can be relied on."""

from __future__ import annotations

from collections import Counter

import pytest

from slam.backend.solver import Optimization
from slam.final_map import judge_outcome

CONVERGED = Optimization(True, 4, 1.0)


def test_drive_without_trouble_is_well():
    outcome = judge_outcome(CONVERGED, Counter(odometry_used=10, odometry_duplicated=10))
    assert (outcome.level, outcome.message) == ("info", "optimised")


@pytest.mark.parametrize(
    ("optimization", "counters", "message"),
    [
        (Optimization(False, 50, 9.0), {"odometry_used": 1}, "did not converge in 50 iterations"),
        (CONVERGED, {"odometry_used": 1, "odometry_out_of_order": 2}, "their stamps do not increase"),
        (CONVERGED, {"odometry_used": 1, "covariances_missing": 3}, "optimised"),
    ],
)
def test_trouble_makes_it_a_warning(optimization, counters, message):
    outcome = judge_outcome(optimization, Counter(counters))
    assert outcome.level == "warning"
    assert message in outcome.message


def test_doubts_about_the_map_are_reported() -> None:
    outcome = judge_outcome(CONVERGED, Counter(odometry_used=10), ["30 % of the objects seem to move"])
    assert outcome.level == "warning"
    assert "30 % of the objects seem to move" in outcome.message


def test_judge_outcome_does_not_call_an_uncorrected_odometry_optimised() -> None:
    outcome = judge_outcome(CONVERGED, Counter(odometry_used=10), uncorrected="no scan has an object")
    assert outcome.level == "warning"
    assert outcome.message.startswith("not corrected")
    assert "no scan has an object" in outcome.message
    assert "optimised" not in outcome.message
