from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import ObjectMapRecord
from slam.common.geometry import invert
from slam.fleet.condensed_map import condense_map
from slam.fleet.joins import PlaceIndex, read_joins, write_joins
from slam.object_map.map_io import SavedMap
from tests.helpers.driven_maps import drive_poses, driven_map, town
from tests.slam.fleet.parts import CELL_M, CONFIG

FIRST, SECOND = (0.0, 150.0), (110.0, 40.0)


@pytest.fixture(scope="module")
def maps() -> list[SavedMap]:
    drives = enumerate((FIRST, SECOND))
    return [condense_map(driven_map(town(), *drive, seed=seed), cell_m=CELL_M) for seed, drive in drives]


def test_a_place_is_found_in_the_map_that_has_it_and_with_its_landmarks(maps: list[SavedMap], tmp_path: Path) -> None:
    other = driven_map(town(7), 0.0, 100.0, seed=3)
    joins = PlaceIndex([other, maps[0]], CONFIG).find_joins(maps[1])
    assert len({join.place for join in joins}) == len(joins) == len(maps[1].graph.keyframe_ids)
    T_first_second = invert(drive_poses(town(), *FIRST)[0]) @ drive_poses(town(), *SECOND)[0]
    for join in joins:
        assert (join.reference_map, join.query_map) == (1, 2)
        assert np.linalg.norm((join.T_reference_query - T_first_second)[:2, 3]) < 0.5
        names = [(maps[1].objects.ids[query], maps[0].objects.ids[reference]) for query, reference in join.pairs]
        assert np.mean([query == reference for query, reference in names]) > 0.95
    write_joins(tmp_path / "joins.json", joins)
    np.testing.assert_equal(
        [each.pairs for each in read_joins(tmp_path / "joins.json")], [each.pairs for each in joins]
    )


def test_a_place_that_a_map_has_twice_is_not_recognised(maps: list[SavedMap]) -> None:
    objects = maps[0].objects
    positions = np.concatenate([objects.positions, objects.positions + np.array([0.0, 400.0, 0.0])])
    classes = [objects.vocabulary.index(label) for label in objects.labels * 2]
    ids = tuple(map(str, range(len(positions))))
    twice = replace(maps[0], objects=ObjectMapRecord.of_objects(ids, positions, classes, objects.vocabulary))
    assert PlaceIndex([twice], CONFIG).find_joins(maps[1]) == []
