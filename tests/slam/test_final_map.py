"""Whether the result of a drive can be relied on, and which landmarks of a prior map it passed."""

import re
from collections import Counter

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Observation
from slam.backend.solver import Optimization
from slam.common.calibration import ObjectCalibration
from slam.common.errors import FactorGraphError
from slam.final_map import find_passed, judge_outcome, known_covariances
from slam.object_map.landmarks import ObjectMap
from tests.helpers.landmarks import add_landmarks

CONVERGED = Optimization(True, 4, 1.0)


def test_drive_without_trouble_is_well():
    outcome = judge_outcome(CONVERGED, Counter(odometry_used=10, odometry_duplicated=10))
    assert outcome == ("info", "optimised")


@pytest.mark.parametrize(
    ("optimization", "counters", "found", "message"),
    [
        (Optimization(False, 50, 9.0), {}, {}, ".*did not converge in 50 iterations"),
        (CONVERGED, {"odometry_out_of_order": 2}, {}, "optimised; .* their stamps do not increase"),
        (CONVERGED, {"covariances_missing": 3}, {}, "optimised"),
        (CONVERGED, {}, {"doubts": ["objects move"]}, "optimised; objects move"),
        (CONVERGED, {}, {"uncorrected": "no scan"}, "not corrected, the trajectory is that of the odometry: no scan"),
    ],
)
def test_judge_outcome_warns_of_trouble(optimization, counters, found, message):
    level, told = judge_outcome(optimization, Counter({"odometry_used": 1, **counters}), **found)
    assert level == "warning"
    assert re.match(message, told)


def test_a_graph_that_determines_too_little_has_no_covariances(monkeypatch: pytest.MonkeyPatch) -> None:
    graph, counters = FactorGraph(), Counter[str]()
    graph.add_keyframe(0, np.eye(4))
    graph.add_observations([Observation(0, 3, np.ones(3), np.eye(3))])
    poses, landmarks = known_covariances(graph, counters)
    assert (poses.shape, landmarks.shape) == ((1, 6, 6), (1, 3, 3))

    def fail() -> None:
        raise FactorGraphError("underdetermined")

    monkeypatch.setattr(graph, "covariances", fail)
    assert [len(each) for each in known_covariances(graph, counters)] == [0, 0]
    assert counters["covariances_missing"] == 1


PATH = np.column_stack([np.arange(100.0, 126.0, 5.0), np.zeros((6, 2))])
"""Six keyframes on 25 m."""


def street(*landmarks_m: float) -> ObjectMap:
    """Landmarks along the x axis."""
    positions = np.column_stack([landmarks_m, np.zeros((len(landmarks_m), 2))])
    object_map = ObjectMap(ObjectCalibration())
    rows = add_landmarks(object_map, positions)
    object_map.assign(rows, position_map=positions)
    return object_map


@pytest.mark.parametrize(("x_m", "is_passed"), [(109.9, False), (110.1, True), (114.9, True), (115.1, False)])
def test_find_passed_counts_six_keyframes_in_reach(x_m: float, is_passed: bool) -> None:
    assert find_passed(street(x_m), 0, PATH, 15.0).tolist() == ([0] if is_passed else [])
    for too_short in (PATH[1:], PATH[:0]):
        assert find_passed(street(x_m), 0, too_short, 15.0).tolist() == []


def test_find_passed_leaves_out_landmarks_of_the_drive_and_retired_ones() -> None:
    object_map = street(112.0, 113.0, 114.0)
    object_map.assign(np.array([0]), segment=1)
    object_map.assign(np.array([1]), state=2)
    assert find_passed(object_map, 0, PATH, 15.0).tolist() == [2]
