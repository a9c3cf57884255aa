"""A map taken into a graph: one that moves with it, and one that stays as it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, Factor
from slam.common.calibration import ObjectCalibration
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.common.geometry import invert
from slam.library import save_map
from slam.localization.prior_map import load_prior_map, restore_prior_map, with_heights_of
from slam.object_map.landmarks import LandmarkState, ObjectMap, RetirementReason
from slam.object_map.map_io import SavedMap, confirmed
from slam.place_recognition.imported_map import make_imported_map
from tests.helpers.graphs import PLAIN, chained, observed_from, odometry_edges
from tests.helpers.landmarks import add_landmarks
from tests.helpers.poses import pose_at

SURE = np.diag(np.repeat([1e-4, 1e-4], 3))
LOOSE = np.diag(np.repeat([0.1, 4.0], 3))
SEEN = 0.05**2 * np.eye(3)
OBJECTS = np.array([[4.0, 3.0, 0.5], [6.0, -4.0, 1.0], [9.0, 2.0, 0.0], [12.0, -3.0, 0.4]])
POSES = np.stack([pose_at(0.0), pose_at(2.0), pose_at(4.0)])
NEW_POSE = pose_at(5.0, 1.0, yaw=0.3)
OFFSET = np.array([0.2, -0.1, 0.1])
"""By how much the drive sees everything beside where the map has it."""


@pytest.fixture
def saved() -> SavedMap:
    object_map = ObjectMap(ObjectCalibration())
    rows = add_landmarks(object_map, OBJECTS, ("tree", "lamp", "tree", "bench"))
    seen = [each for k, T in enumerate(POSES) for each in observed_from(k, T, OBJECTS, range(4), SEEN)]
    graph = chained(POSES[0], odometry_edges(POSES, SURE), seen)
    graph.optimize()
    object_map.assign(rows, position_map=graph.landmark_positions(rows), covariance_map=graph.covariances()[1])
    return SavedMap(confirmed(object_map.to_record(9)), graph.to_record(9, np.arange(3)))


def loaded(saved: SavedMap, *, fixed: bool) -> tuple[ObjectMap, FactorGraph]:
    object_map, graph = ObjectMap(ObjectCalibration()), FactorGraph(kernel_width=PLAIN)
    keyframes, _ = restore_prior_map(saved, object_map, graph, fixed=fixed)
    assert [keyframe.id for keyframe in keyframes] == [0, 1, 2]
    return object_map, graph


def see_again(graph: FactorGraph) -> None:
    """A fourth keyframe, placed wrongly by a metre, that sees objects 4 to 7, which are landmarks 0 to 3 of the map."""
    wrong = pose_at(6.0, 0.5, yaw=0.2)
    graph.add_next_keyframe(Edge(2, 3, invert(POSES[2]) @ wrong, LOOSE, "odometry"))
    seen = observed_from(3, NEW_POSE, OBJECTS + OFFSET, range(4), SEEN)
    graph.add_observations([replace(each, landmark=4 + each.landmark) for each in seen])
    graph.update()
    merge(graph)


def merge(graph: FactorGraph) -> None:
    graph.alias_landmarks({4 + row: row for row in range(4)})
    graph.optimize()


def assert_found(graph: FactorGraph) -> None:
    """Everything is seen beside where the map has it, so the robot is that far beside where it is, the other way."""
    assert graph.landmarks.tolist() == []
    np.testing.assert_allclose(graph.pose(3)[:3, 3], NEW_POSE[:3, 3] - OFFSET, atol=0.03)


def test_a_map_comes_back_as_the_graph_that_it_was(saved: SavedMap) -> None:
    object_map, graph = loaded(saved, fixed=False)
    np.testing.assert_allclose(graph.poses(), saved.graph.T_map_body, atol=1e-6)
    np.testing.assert_allclose(graph.landmark_positions(np.arange(4)), saved.objects.positions, atol=1e-6)
    np.testing.assert_allclose(graph.covariances()[1], saved.objects.covariances, rtol=1e-3, atol=1e-9)
    assert object_map.in_state(LandmarkState.CONFIRMED).tolist() == [0, 1, 2, 3]


def test_load_prior_map_reads_maps_of_either_kind(saved: SavedMap, tmp_path: Path) -> None:
    for known in (saved, make_imported_map(OBJECTS, ["tree"] * 4, list("abcd"), sigma_m=0.3)):
        save_map(tmp_path / "map.mcap", known)
        assert type(load_prior_map(tmp_path / "map.mcap")) is type(known)


def test_a_path_is_no_map() -> None:
    with pytest.raises(InputDataError, match=r"not a map: 'town\.mcap'; load_map"):
        with_heights_of(Config(), "town.mcap")


def test_landmarks_of_a_fixed_map_stay_and_tell_where_the_robot_is(saved: SavedMap) -> None:
    _, graph = loaded(saved, fixed=True)
    see_again(graph)
    assert_found(graph)
    np.testing.assert_array_equal(graph.poses()[:3], saved.graph.T_map_body)
    np.testing.assert_allclose(graph.landmark_positions(np.arange(4)), saved.objects.positions, atol=1e-3)


def test_twin_landmarks_of_a_map_that_is_extended_move(saved: SavedMap) -> None:
    _, graph = loaded(saved, fixed=False)
    before = graph.landmark_positions(np.arange(4))
    graph.add_next_keyframe(Edge(2, 3, invert(POSES[2]) @ NEW_POSE, SURE, "odometry"))
    graph.add_observations(observed_from(3, NEW_POSE, OBJECTS + OFFSET, range(4), SEEN))
    graph.optimize()
    assert np.linalg.norm(graph.landmark_positions(np.arange(4)) - before, axis=1).min() > 0.01


def test_what_was_merged_into_such_a_map_can_be_taken_apart_again(saved: SavedMap) -> None:
    _, graph = loaded(saved, fixed=True)
    numbers = set(graph.factors)
    see_again(graph)
    graph.alias_landmarks({})
    graph.update()
    assert graph.landmarks.tolist() == [4, 5, 6, 7]
    left: list[Factor] = [factor for number, factor in graph.factors.items() if number not in numbers]
    assert {type(factor).__name__ for factor in left} == {"Edge", "Observation"}
    graph.optimize()
    merge(graph)
    assert_found(graph)


def test_a_fixed_map_does_not_move_with_a_segment_that_is_connected_to_it(saved: SavedMap) -> None:
    _, graph = loaded(saved, fixed=True)
    see_again(graph)
    far = pose_at(40.0, 9.0, yaw=1.0)
    graph.add_joining_edge(Edge(0, 3, far, SURE, "closure"), {3})
    np.testing.assert_array_equal(graph.poses()[:3], saved.graph.T_map_body)
    np.testing.assert_allclose(graph.landmark_positions(np.arange(4)), saved.objects.positions, atol=0.05)


def test_retiring_a_landmark_retires_what_was_merged_into_it(saved: SavedMap) -> None:
    object_map, _ = loaded(saved, fixed=False)
    object_map.merge(0, 2)
    object_map.retire(np.array([0]), RetirementReason.GONE)
    assert object_map.rows["state"].tolist() == [2, 1, 2, 1]
    assert object_map.to_record(9).reasons == ("gone", "", "merged into 0", "")
