from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.common.geometry import apply, invert
from slam.map_joining.condensed_map import condense_area, condense_map, place_submap_rows
from slam.object_map.map_validation import find_fault
from tests.helpers.driven_maps import driven_map, town

STRETCH_M = 25.0


def test_a_condensed_map_keeps_its_landmarks_and_shape() -> None:
    whole = driven_map(town(), 0.0, 300.0)
    condensed = condense_map(whole, stretch_m=STRETCH_M)
    assert condensed.objects.ids == whole.objects.ids
    assert len(condensed.graph.keyframe_ids) == 12
    assert find_fault(condensed.objects, condensed.graph) == ""
    for place, name, position in zip(
        condensed.graph.observation_keyframe_ids,
        condensed.graph.observation_landmark_ids,
        condensed.graph.observation_positions,
        strict=True,
    ):
        expected = condensed.objects.positions[condensed.objects.ids.index(name)]
        np.testing.assert_allclose(apply(condensed.graph.T_map_body[place], position[None])[0], expected, atol=1e-9)


def test_a_second_drive_along_a_street_adds_no_places_but_its_observations() -> None:
    once = driven_map(town(), 0.0, 100.0)
    graph = once.graph
    count = len(graph.keyframe_ids)
    again = replace(
        graph,
        keyframe_ids=np.append(graph.keyframe_ids, graph.keyframe_ids + count),
        keyframe_stamps_ns=np.tile(graph.keyframe_stamps_ns, 2),
        T_map_body=np.tile(graph.T_map_body, (2, 1, 1)),
        edge_keyframe_ids=np.vstack([graph.edge_keyframe_ids, graph.edge_keyframe_ids + count, [[0, count]]]),
        edge_transforms=np.concatenate([graph.edge_transforms, graph.edge_transforms, np.eye(4)[None]]),
        edge_covariances=np.concatenate([graph.edge_covariances, graph.edge_covariances, np.eye(6)[None]]),
        edge_kinds=(*graph.edge_kinds * 2, "closure"),
        observation_keyframe_ids=np.append(graph.observation_keyframe_ids, graph.observation_keyframe_ids + count),
        observation_landmark_ids=graph.observation_landmark_ids * 2,
        observation_positions=np.tile(graph.observation_positions, (2, 1)),
        observation_covariances=np.tile(graph.observation_covariances, (2, 1, 1)),
    )
    single, double = (condense_area(replace(once, graph=each), stretch_m=STRETCH_M) for each in (graph, again))
    assert find_fault(double.objects, double.graph) == ""
    assert double.objects.ids == single.objects.ids
    np.testing.assert_array_equal(double.graph.T_map_body, single.graph.T_map_body)
    np.testing.assert_allclose(double.graph.observation_covariances, 0.5 * single.graph.observation_covariances)


def test_observations_of_a_stretch_add_up() -> None:
    whole = driven_map(town(), 0.0, 100.0)
    condensed = condense_map(whole, stretch_m=200.0)
    names = list(whole.graph.observation_landmark_ids)
    for name, covariance in zip(
        condensed.graph.observation_landmark_ids, condensed.graph.observation_covariances, strict=True
    ):
        np.testing.assert_allclose(covariance, 0.1**2 / names.count(name) * np.eye(3), atol=1e-12)


def test_edges_between_places_are_as_uncertain_as_the_steps_between_them() -> None:
    whole = driven_map(town(), 0.0, 100.0)
    condensed = condense_map(whole, stretch_m=STRETCH_M)
    variances = condensed.graph.edge_covariances[:, 2, 2]
    np.testing.assert_allclose(variances, 1e-5 * STRETCH_M / 2.0, rtol=0.2)
    # The heading moves what lies ahead sideways: more than the steps alone.
    assert (condensed.graph.edge_covariances[:, 4, 4] > 1.05 * 1e-3 * 12).any()
    T_world = condensed.graph.T_map_body
    for (first, second), T in zip(condensed.graph.edge_keyframe_ids, condensed.graph.edge_transforms, strict=True):
        np.testing.assert_allclose(T, invert(T_world[first]) @ T_world[second], atol=1e-9)


def test_a_break_of_the_odometry_ends_a_stretch() -> None:
    whole = driven_map(town(), 0.0, 100.0)
    kinds = list(whole.graph.edge_kinds)
    kinds[20] = "closure"  # what ties the two parts together is no odometry
    from dataclasses import replace

    condensed = condense_map(replace(whole, graph=replace(whole.graph, edge_kinds=tuple(kinds))), stretch_m=200.0)
    assert len(condensed.graph.keyframe_ids) == 2
    assert condensed.graph.edge_kinds == ("closure",)


def test_a_submap_reaches_to_the_places_beside_it() -> None:
    condensed = condense_map(driven_map(town(), 0.0, 300.0), stretch_m=STRETCH_M)
    seen_from = [
        {
            name
            for place, name in zip(
                condensed.graph.observation_keyframe_ids, condensed.graph.observation_landmark_ids, strict=True
            )
            if place == number
        }
        for number in range(12)
    ]
    rows = place_submap_rows(condensed, 5)
    assert {condensed.objects.ids[row] for row in rows} == seen_from[4] | seen_from[5] | seen_from[6]
