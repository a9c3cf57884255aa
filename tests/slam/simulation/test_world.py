from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from slam.common.errors import SimulationError
from slam.simulation.world import World, load_world
from tests.slam.simulation.worlds import straight_street

CITIES = Path(os.environ.get("DSLAM_DATA", Path(__file__).parents[3] / ".." / "shared" / "data")) / "cities"

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


def test_columns_may_stand_in_any_order(tmp_path: Path) -> None:
    world = _load(tmp_path, objects="id,class,z_m,y_m,x_m\nn1,tree,3,2,1\n", tour="y_m,x_m\n0,0\n5,0\n")
    np.testing.assert_array_equal(world.positions, [[1, 2, 3]])
    np.testing.assert_array_equal(world.tour[1], [0, 5])


@pytest.mark.parametrize(
    ("objects", "tour", "message"),
    [
        ("x_m,class\n1,tree\n", TOUR, "objects.csv.*y_m"),
        ("x_m,y_m,z_m,class,id\n", TOUR, "objects.csv|no object"),
        (OBJECTS + "1,two,0,tree,n3,\n", TOUR, "objects.csv, line 4.*'two'"),
        (OBJECTS + "1,2,0,tree,n1,\n", TOUR, "objects.csv, line 4, column id: 'n1' is taken by an earlier line"),
        ("lat,lon,class\n48,11,tree\n", TOUR, "in degrees"),
        (OBJECTS, "x_m\n1\n2\n", "trajectory.csv.*y_m"),
        (OBJECTS, "x_m,y_m\n0,0\n", "trajectory.csv: 1 poses"),
        (OBJECTS, "x_m,y_m\n0,0\n0,0\n", "all 2 points of the tour are the same"),
    ],
)
def test_damage_is_refused_with_file_and_line(tmp_path: Path, objects: str, tour: str, message: str) -> None:
    with pytest.raises((SimulationError, DatasetError), match=message):
        _load(tmp_path, objects, tour)


def test_inconsistent_world_is_refused() -> None:
    world = straight_street()
    for changes in (
        {"object_ids": ("a",) * len(world.labels)},
        {"labels": world.labels[1:]},
        {"positions": world.positions[:, :2]},
        {"positions": np.full_like(world.positions, np.nan)},
        {"tour": world.tour[:1]},
        {"object_ids": (), "labels": (), "positions": np.zeros((0, 3))},
    ):
        with pytest.raises(SimulationError, match="street"):
            dataclasses.replace(world, **changes)


def test_digest_depends_on_content_and_not_on_the_name() -> None:
    world = straight_street()
    assert dataclasses.replace(world, name="other").sha256() == world.sha256()
    assert dataclasses.replace(world, positions=world.positions + 0.01).sha256() != world.sha256()


@pytest.mark.skipif(not CITIES.is_dir(), reason=f"no city data in {CITIES}; set DSLAM_DATA to the folder above it")
def test_helsinki() -> None:
    world = load_world(CITIES / "helsinki" / "objects.csv", CITIES / "helsinki" / "trajectory.csv")
    assert (world.name, len(world.object_ids), len(world.vocabulary)) == ("helsinki", 1038, 35)
    assert world.tour_length_m == pytest.approx(3287, abs=1)
