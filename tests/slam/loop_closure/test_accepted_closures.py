"""Accepted closures and the factors that represent them: both go together."""

from __future__ import annotations

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge
from slam.common.arrays import FloatArray
from slam.common.config import AssociationConfig, Config, FactorGraphConfig
from slam.common.geometry import transform_from_xyz_yaw
from slam.loop_closure.accepted_closures import AcceptedClosures
from slam.object_map.landmarks import ObjectMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose
from tests.helpers.candidates import make_candidate

STEP_M = 2.0
ROUND = 90
"""Keyframes of the first round, of which the second one is the same."""


def pose(x_m: float) -> FloatArray:
    return transform_from_xyz_yaw(np.array([x_m, 0.0, 0.0]), 0.0)


class Drive:
    """A street driven twice, without objects."""

    def __init__(self) -> None:
        graph = FactorGraph(FactorGraphConfig(observation_kernel="none"))
        self.keyframes: list[Keyframe] = []
        self.closures = AcceptedClosures(Config(), ObjectMap(AssociationConfig()), graph, self.keyframes)
        self.graph = graph
        for number in range(ROUND + 30):
            odometry = OdometryPose(10**9 * number, pose(STEP_M * number), STEP_M * number, 0, STEP_M)
            self.keyframes.append(Keyframe(number, odometry, odometry.T_odom_body))
            if number == 0:
                graph.add_first_keyframe(0, pose(0.0))
            else:
                covariance = np.diag(np.repeat([1e-6, 1e-2], 3))
                graph.add_next_keyframe(Edge(number - 1, number, pose(STEP_M), covariance, "odometry"))
        graph.update()

    def accept(self, query: int) -> None:
        candidate = make_candidate(
            query=query,
            reference=query - ROUND,
            travel_m=STEP_M * query,
            T_reference_query=pose(STEP_M * ROUND),
            T_local_query=pose(STEP_M * query),
        )
        self.closures.add(candidate, "")

    def declare_lost(self, since: int) -> list[int]:
        records, _ = self.closures.revoke_since(self.keyframes[-1], since)
        assert not any(record.accepted for record in records)
        return sorted(record.query_keyframe_id for record in records)

    @property
    def closed(self) -> list[int]:
        return self.closures.keyframes[:, 0].tolist()

    @property
    def factors(self) -> list[int]:
        return [f.to_keyframe for f in self.graph.factors.values() if isinstance(f, Edge) and f.kind == "closure"]


@pytest.fixture
def street() -> Drive:
    return Drive()


def test_a_closure_leaves_the_map_with_the_factor_that_represents_it(street):
    street.accept(100)
    street.accept(99)
    assert street.factors == [100]
    assert street.declare_lost(since=100) == [99, 100]
    assert street.factors == []
    assert street.closed == []
    assert street.closures.keyframes_nearby() == set()


def test_a_closure_that_is_inconsistent_goes_although_its_factor_stays(street):
    street.accept(99)
    street.accept(100)
    assert street.factors == [99]
    assert street.declare_lost(since=100) == [100]
    assert street.factors == [99]
    assert street.closed == [99]


def test_closures_from_before_the_robot_was_lost_stay(street):
    street.accept(95)
    street.accept(110)
    assert street.declare_lost(since=105) == [110]
    assert street.closed == street.factors == [95]
