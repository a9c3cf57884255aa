from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slam.common.geometry import apply, invert
from slam.fleet.condensed_map import condense_map, place_landmarks
from slam.object_map.map_io import SavedMap
from slam.object_map.map_validation import find_fault
from tests.helpers.driven_maps import driven_map, town
from tests.slam.fleet.parts import CONFIG

CELL_M = 25.0


@pytest.fixture(scope="module")
def whole() -> SavedMap:
    return driven_map(town(), 0.0, 100.0)


def condense(whole: SavedMap, **changed: Any) -> SavedMap:
    """The map with other fields of its graph, condensed."""
    return condense_map(replace(whole, graph=replace(whole.graph, **changed)), CONFIG)


@pytest.fixture(scope="module")
def condensed(whole: SavedMap) -> SavedMap:
    return condense(whole)


def test_a_condensed_map_keeps_its_landmarks_and_shape(whole: SavedMap, condensed: SavedMap) -> None:
    graph, objects = condensed.graph, condensed.objects
    assert objects.ids == whole.objects.ids
    assert len(graph.keyframe_ids) == 5
    assert find_fault(objects, graph) == ""
    rows = [objects.ids.index(name) for name in graph.observation_landmark_ids]
    T_map_place = graph.T_map_body[graph.observation_keyframe_ids]
    seen_at = [apply(T, each[None])[0] for T, each in zip(T_map_place, graph.observation_positions, strict=True)]
    np.testing.assert_allclose(seen_at, objects.positions[rows], atol=1e-9)


def test_a_second_drive_along_a_street_adds_no_places_but_its_observations(
    whole: SavedMap, condensed: SavedMap
) -> None:
    graph, count = whole.graph, len(whole.graph.keyframe_ids)
    twice = {
        name: np.concatenate([getattr(graph, name)] * 2)
        for name in ("keyframe_stamps_ns", "T_map_body", "observation_positions", "observation_covariances")
    }
    double = condense(
        whole,
        **twice,
        keyframe_ids=np.arange(2 * count),
        edge_keyframe_ids=np.array([[0, count]]),
        edge_transforms=np.eye(4)[None],
        edge_covariances=np.eye(6)[None],
        edge_kinds=("closure",),
        observation_keyframe_ids=np.append(graph.observation_keyframe_ids, graph.observation_keyframe_ids + count),
        observation_landmark_ids=graph.observation_landmark_ids * 2,
    )
    assert double.objects.ids == condensed.objects.ids
    np.testing.assert_array_equal(double.graph.T_map_body, condensed.graph.T_map_body)
    np.testing.assert_allclose(double.graph.observation_covariances, 0.5 * condensed.graph.observation_covariances)


def test_the_place_at_the_origin_comes_first_also_if_drives_came_from_behind_it(whole: SavedMap) -> None:
    T_map_body = whole.graph.T_map_body.copy()
    T_map_body[:, 0, 3] -= 60.0
    folded = condense(whole, T_map_body=T_map_body)
    from_origin_m = np.linalg.norm(folded.graph.T_map_body[:, :3, 3], axis=1)
    assert from_origin_m[0] == from_origin_m.min() < 0.5 * CELL_M


def test_a_level_drive_passes_one_row_of_cells_whatever_its_noise(whole: SavedMap) -> None:
    rng = np.random.default_rng(0)
    T_map_body = whole.graph.T_map_body.copy()
    T_map_body[:, 1:3, 3] = rng.normal(0.0, 0.05, (len(T_map_body), 2))
    folded = condense(whole, T_map_body=T_map_body)
    assert len(folded.graph.keyframe_ids) == len(np.unique(np.round(T_map_body[:, 0, 3] / CELL_M)))


def test_edges_between_places_are_as_uncertain_as_the_steps_between_them(condensed: SavedMap) -> None:
    graph = condensed.graph
    first, second = graph.T_map_body[graph.edge_keyframe_ids.T]
    np.testing.assert_allclose(graph.edge_transforms, invert(first) @ second, atol=1e-9)
    lengths_m = np.linalg.norm(graph.edge_transforms[:, :3, 3], axis=1)
    np.testing.assert_allclose(graph.edge_covariances[:, 2, 2], 1e-5 * lengths_m / 2.0, rtol=0.2)


def test_places_that_only_a_closure_ties_have_its_edge(whole: SavedMap) -> None:
    kinds = ["closure" if 20 <= row < 40 else kind for row, kind in enumerate(whole.graph.edge_kinds)]
    tied = condense(whole, edge_kinds=tuple(kinds))
    assert set(tied.graph.edge_kinds) == {"odometry", "closure"}
    assert find_fault(tied.objects, tied.graph) == ""


def test_place_landmarks_are_those_of_the_places_beside_it_too(condensed: SavedMap) -> None:
    graph = condensed.graph
    names = np.array(graph.observation_landmark_ids)[np.isin(graph.observation_keyframe_ids, (0, 1, 2))]
    assert {condensed.objects.ids[row] for row in place_landmarks(condensed, 1)} == set(names.tolist())
    assert len(place_landmarks(condensed, 1)) < len(condensed.objects.ids)
