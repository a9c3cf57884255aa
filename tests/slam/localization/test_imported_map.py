"""A robot finds itself in a map that nobody drove, follows it there, and may bend it."""

from dataclasses import replace

import numpy as np
import pytest

from logs.messages import GroundTruthPose, ObjectDetections, Odometry, SlamPose, Transform
from slam.common.config import Config
from slam.display.map_topics import CLOSURES
from slam.final_map import FinalMap
from slam.localization.prior_map import PriorMap
from slam.place_recognition.imported_map import make_imported_map
from slam.simulation.config import SimulationConfig
from slam.simulation.simulation import simulate
from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import World
from slam.system import Slam
from tools.lab.drives.true_drive import truth_of

LENGTH_M = 60.0
FAR_M = 30_000.0
"""From the origin of the map: no error may grow with that."""


@pytest.fixture(scope="module")
def town() -> World:
    world = generate_street_grid(rng=np.random.default_rng(3))
    shift = np.array([FAR_M, -FAR_M, 0.0])
    return replace(world, positions=world.positions + shift, tour=world.tour + shift[:2])


def city_map(town: World) -> PriorMap:
    rng = np.random.default_rng(5)
    kept = np.flatnonzero(rng.random(len(town.labels)) > 0.2)
    positions = town.positions[kept] * [1.0, 1.0, 0.0]
    return make_imported_map(
        positions, [town.labels[row] for row in kept], [town.object_ids[row] for row in kept], sigma_m=0.3
    )


def drive(town: World, known: PriorMap, *, extend: bool) -> tuple[list[float], FinalMap, Slam]:
    """Errors [m] of the poses in the map when they came."""
    records = list(simulate(town.shortened(LENGTH_M), SimulationConfig(), seed=2))
    truth = truth_of(records)
    slam, errors = Slam(Config(), known, extend=extend), list[float]()
    for record in records:
        if not isinstance(record, Odometry | ObjectDetections | Transform) or isinstance(record, GroundTruthPose):
            continue
        for update in slam.process(record):
            if isinstance(update, SlamPose):
                row = np.searchsorted(truth.stamps_ns, update.stamp_ns)
                errors.append(float(np.linalg.norm((update.T_map_body - truth.T_world_body[row])[:2, 3])))
    return errors, slam.finish(), slam


@pytest.mark.slow
@pytest.mark.parametrize("extend", [False, True])
def test_the_robot_is_found_with_a_fifth_of_the_objects_missing(town: World, extend: bool) -> None:
    errors, final, slam = drive(town, city_map(town), extend=extend)
    assert slam.fixes
    assert slam.fixes[0].travel_m < 30.0
    assert np.sqrt(np.mean(np.square(errors))) < 0.5
    # The optimised trajectory lies in the map, too, and lines to its far origin are not drawn.
    assert abs(final.trajectory.T_map_body[0, 0, 3] - town.tour[0, 0]) < 1.0
    assert dict(final.snapshot)[CLOSURES].polylines == ()
