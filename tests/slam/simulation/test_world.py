import dataclasses
from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from slam.common.errors import SimulationError
from slam.simulation.world import World, load_world
from tests.helpers.loop_drives import one_block

OBJECTS = "x_m,y_m,z_m,class,id,detail\n1,2,0.5,tree,n1,oak\n3,4,0,bench,n2,\n"
TOUR = "x_m,y_m\n0,0\n1,0\n1,1\n"


def _load(folder: Path, objects: str = OBJECTS, tour: str = TOUR) -> World:
    (folder / "objects.csv").write_text(objects)
    (folder / "trajectory.csv").write_text(tour)
    return load_world(folder / "objects.csv", folder / "trajectory.csv")


def test_csv_becomes_a_world(tmp_path: Path) -> None:
    folder = tmp_path / "smallville"
    folder.mkdir()
    world = _load(folder)
    assert (world.name, world.object_ids, world.labels) == ("smallville", ("n1", "n2"), ("tree", "bench"))
    assert world.vocabulary == ("bench", "tree")
    np.testing.assert_array_equal(world.positions, [[1, 2, 0.5], [3, 4, 0]])
    assert world.tour_length_m == 2.0


@pytest.mark.parametrize(
    ("objects", "tour", "message"),
    [
        ("x_m,y_m,z_m,class,id\n", TOUR, "objects.csv|no object"),
        ("lat,lon,class\n48,11,tree\n", TOUR, "in degrees"),
        (OBJECTS, "x_m,y_m\n0,0\n", "trajectory.csv: 1 poses"),
        (OBJECTS, "x_m,y_m\n0,0\n0,0\n", "all 2 points of the tour are the same"),
    ],
)
def test_damage_is_refused_with_file_and_line(tmp_path: Path, objects: str, tour: str, message: str) -> None:
    with pytest.raises((SimulationError, DatasetError), match=message):
        _load(tmp_path, objects, tour)


def test_digest_depends_on_content_and_not_on_the_name() -> None:
    world = one_block()
    assert dataclasses.replace(world, name="other").sha256() == world.sha256()
    assert dataclasses.replace(world, positions=world.positions + 0.01).sha256() != world.sha256()
