"""The weight of the odometry in the graph where landmarks contradict its heading."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.backend.solver_options import FactorGraphConfig
from slam.common.config import Config
from slam.common.geometry import transform_from_xyz_yaw
from slam.frontend.failed_headings import loosen_failed_headings
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import step_covariance
from slam.odometry.pose import OdometryPose

CONFIG = Config()


def drive(turn_rad: float) -> tuple[FactorGraph, list[Keyframe]]:
    """Ten keyframes of an odometry that goes straight, where landmarks tell a turn in each step; none is tied to a
    landmark.
    """
    graph, keyframes = FactorGraph(FactorGraphConfig()), list[Keyframe]()
    for number in range(10):
        xyz_m = np.array([2.0 * number, 0.0, 0.0])
        pose = OdometryPose(number * 10**9, transform_from_xyz_yaw(xyz_m, 0.0), 2.0 * number, 0, 2.0)
        keyframes.append(Keyframe(number, pose, transform_from_xyz_yaw(xyz_m, turn_rad * number)))
        if number == 0:
            graph.add_first_keyframe(0, np.eye(4))
        else:
            covariance = step_covariance(keyframes[-2].odometry, pose, CONFIG.calibration.odometry)
            T_step = transform_from_xyz_yaw(np.array([2.0, 0.0, 0.0]), 0.0)
            graph.add_next_keyframe(Edge(number - 1, number, T_step, covariance, EdgeKind.ODOMETRY))
    return graph, keyframes


def doubted(graph: FactorGraph, keyframes: list[Keyframe]) -> int:
    counters = Counter[str]()
    loosen_failed_headings(graph, keyframes, CONFIG, counters)
    return counters["odometry_headings_doubted"]


def test_an_odometry_that_landmarks_confirm_keeps_its_weight() -> None:
    graph, keyframes = drive(0.0)
    before = dict(graph.factors)
    assert doubted(graph, keyframes) == 0
    assert dict(graph.factors) == before


def test_the_odometry_counts_less_where_landmarks_contradict_its_heading() -> None:
    graph, keyframes = drive(0.5)
    edges = {number: each for number, each in graph.factors.items() if isinstance(each, Edge)}
    assert doubted(graph, keyframes) == len(edges) == 9
    for number, before in edges.items():
        after = graph.factors[number]
        assert isinstance(after, Edge)
        assert after.covariance[2, 2] > 100.0 * before.covariance[2, 2]
        np.testing.assert_array_equal(after.covariance[3:, 3:], before.covariance[3:, 3:])
        np.testing.assert_array_equal(after.T_from_to, before.T_from_to)


def test_a_discontinuity_stays_what_it_is() -> None:
    graph, keyframes = drive(0.5)
    ((number, edge),) = (
        (n, each) for n, each in graph.factors.items() if isinstance(each, Edge) and each.to_keyframe == 5
    )
    graph.remove_factor(number)
    loose = graph.add_edge(replace(edge, kind=EdgeKind.DISCONTINUITY))
    doubted(graph, keyframes)
    after = graph.factors[loose]
    assert isinstance(after, Edge)
    np.testing.assert_array_equal(after.covariance, edge.covariance)
