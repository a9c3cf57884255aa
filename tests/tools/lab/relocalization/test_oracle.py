"""What could be known of a kidnapped robot's place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Record
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.common.geometry import transform_from_xyz_yaw
from slam.object_map.map_io import SavedMap
from slam.simulation.config import SimulationConfig
from slam.simulation.simulation import simulate
from slam.simulation.world import World
from tests.helpers.loop_drives import one_block
from tools.lab.relocalization.figures import Tolerance
from tools.lab.relocalization.kidnaps import thin_world
from tools.lab.relocalization.known_map import KnownMap
from tools.lab.relocalization.oracle import Oracle, OracleAnswer

TOLERANCE = Tolerance(1.0, 3.0)


@pytest.fixture(scope="module")
def block() -> World:
    return one_block().shortened(120.0)


@pytest.fixture(scope="module")
def records(block: World) -> list[Record]:
    return [record for _, _, record in simulate(block, SimulationConfig(), seed=1)]


def known_map(world: World, records: Iterable[Record]) -> KnownMap:
    """The world itself as a map."""
    objects = next(each for each in records if hasattr(each, "class_probabilities"))
    T = np.stack([each.T_world_body for each in records if isinstance(each, GroundTruthPose)])
    graph = type("Graph", (), {"T_map_body": T})()
    return KnownMap(SavedMap(objects, graph), T, T, np.eye(4), 0.0)  # type: ignore[arg-type]


def test_among_many_objects_the_place_is_known(block, records):
    answer = Oracle(known_map(block, records), Config()).answer(records, 40.0, TOLERANCE)
    assert answer.is_right
    assert answer.finds(0.005)


def test_without_observations_it_is_not(block, records):
    blind = [each for each in records if not isinstance(each, ObjectDetections | DetectionTruth)]
    assert Oracle(known_map(block, records), Config()).answer(blind, 40.0, TOLERANCE) == OracleAnswer(None, False)


def test_a_pose_away_from_the_truth_is_not_right(block, records):
    known = known_map(block, records)
    shifted = replace(known, T_map_body=known.T_map_body @ transform_from_xyz_yaw(np.array([3.0, 0.0, 0.0]), 0.0))
    assert not Oracle(shifted, Config()).answer(records, 40.0, TOLERANCE).is_right


def test_an_answer_counts_if_it_is_right_and_sure():
    assert OracleAnswer(0.996, is_right=True).finds(0.005)
    assert not OracleAnswer(0.99, is_right=True).finds(0.005)
    assert not OracleAnswer(0.999, is_right=False).finds(0.005)
    assert not OracleAnswer(None, is_right=False).finds(0.005)


def test_a_thinned_world_has_one_of_so_many_objects(block):
    thin = thin_world(block, 5.0, rng=np.random.default_rng(0))
    assert len(thin.labels) == round(len(block.labels) / 5.0)
    assert set(thin.object_ids) < set(block.object_ids)
    again = thin_world(block, 5.0, rng=np.random.default_rng(0))
    assert again.object_ids == thin.object_ids
    assert thin_world(block, 1.0, rng=np.random.default_rng(0)) is block
    assert len(thin_world(block, 1e6, rng=np.random.default_rng(0)).labels) == 1
    with pytest.raises(SimulationError, match="factor of at least 1"):
        thin_world(block, 0.5, rng=np.random.default_rng(0))
