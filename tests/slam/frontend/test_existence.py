"""Whether landmarks exist, by what was seen of them."""

import numpy as np
import pytest

from slam.frontend.mapper import which_exist
from slam.object_map.landmarks import LANDMARK, LandmarkState

SEEN = np.array([0])


def landmarks(*, observations: int, ratio: float, confirmed: int = 0, born: int = 1) -> np.ndarray:
    """The first of them was observed so often since scan 0, with a log-likelihood ratio a match."""
    rows = np.zeros(born, dtype=LANDMARK)
    rows["state"][1 : 1 + confirmed] = LandmarkState.CONFIRMED
    rows["observations"][0] = observations
    rows["log_likelihood_ratio"][0] = ratio * (observations - 1)
    return rows


@pytest.mark.parametrize(
    ("observations", "scan", "ratio", "exists"),
    [
        (4, 3, 4.0, True),
        (4, 3, 0.5, False),  # matches that something else explains as well
        (4, 12, 4.0, False),  # missed too often
        (30, 60, 4.0, True),  # by a detector that sees it in every second scan
        (30, 29, -1.0, False),
        (1, 0, 0.0, True),  # nothing is known
    ],
)
def test_a_landmark_exists_if_chance_does_not_explain_its_matches(observations, scan, ratio, exists):
    rows = landmarks(observations=observations, ratio=ratio)
    assert which_exist(rows, SEEN, scan).tolist() == [exists]


def test_where_hardly_any_landmark_was_confirmed_it_takes_more_to_believe_in_one():
    few = landmarks(observations=4, ratio=3.5, confirmed=10, born=2000)
    most = landmarks(observations=4, ratio=3.5, confirmed=1500, born=2000)
    assert which_exist(few, SEEN, 3).tolist() == [False]
    assert which_exist(most, SEEN, 3).tolist() == [True]


def test_a_scan_with_several_sightings_of_one_landmark_is_no_error():
    assert which_exist(landmarks(observations=9, ratio=4.0), SEEN, 2).tolist() == [True]
