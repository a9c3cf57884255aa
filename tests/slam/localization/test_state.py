"""The localization state, keyframe by keyframe."""

import numpy as np

from slam.localization.state import CONTRADICTED, DISCONTINUITY, LocalizationState, State
from tests.helpers.poses import keyframe_at

KEYFRAME = keyframe_at(np.eye(4), 7, travel_m=20.0)


def update(state: LocalizationState, *, is_localized: bool, began: str = "") -> list[tuple[State, str]]:
    changes = state.update(KEYFRAME, is_localized=is_localized, began=began)
    assert all(level == ("warning" if changed is State.LOST else "info") for changed, _, level in changes)
    return [(changed, message) for changed, message, _ in changes]


def test_a_robot_maps_until_its_odometry_breaks():
    state = LocalizationState(has_prior_map=False)
    assert update(state, is_localized=True) == []
    assert state.state is State.MAPPING
    ((lost, why),) = update(state, is_localized=False, began=DISCONTINUITY)
    assert lost is state.state is State.LOST
    assert why.startswith("odometry discontinuity")
    assert update(state, is_localized=False) == []


def test_a_lost_robot_is_found_again():
    state = LocalizationState(has_prior_map=True)
    assert state.state is State.LOST
    assert update(state, is_localized=False) == []
    assert [each for each, _ in update(state, is_localized=True)] == [State.RELOCALIZED, State.TRACKING]
    assert state.state is State.TRACKING
    assert state.fixes == [KEYFRAME.odometry]
    assert update(state, is_localized=True) == []
    assert update(state, is_localized=False) == [(State.LOST, CONTRADICTED)]


def test_in_a_map_of_its_own_a_robot_that_is_found_again_maps_on():
    state = LocalizationState(has_prior_map=False)
    update(state, is_localized=False, began=DISCONTINUITY)
    assert [each for each, _ in update(state, is_localized=True)] == [State.RELOCALIZED, State.MAPPING]
