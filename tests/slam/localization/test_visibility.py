"""Where a sensor sees landmarks, learned on the drive."""

from __future__ import annotations

import numpy as np

from slam.localization.continuity_monitor import PRIOR_EXPECTED, Visibility

AHEAD, BEHIND, FAR = np.array([[5.0, 1.0]]), np.array([[-5.0, 1.0]]), np.array([[31.0, 1.0]])


def test_the_probability_of_a_sighting_is_the_share_of_those_that_were_expected() -> None:
    visibility = Visibility(30.0)
    assert visibility.probability(AHEAD) == 0.0
    visibility.learn(np.repeat(AHEAD, 4, axis=0), np.array([True, True, True, False]))
    assert visibility.probability(AHEAD) == 3.0 / (4.0 + PRIOR_EXPECTED)
    assert visibility.probability(BEHIND) == 0.0


def test_nothing_is_learned_of_what_is_out_of_range() -> None:
    visibility = Visibility(30.0)
    visibility.learn(FAR, np.array([True]))
    assert visibility.probability(FAR) == 0.0
