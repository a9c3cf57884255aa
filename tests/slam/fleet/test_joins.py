from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import ObjectMapRecord
from slam.common.geometry import invert
from slam.fleet.condensed_map import condense_map
from slam.fleet.joins import Join, accept_joins, find_joins, read_joins, why_alone, write_joins
from slam.object_map.map_io import SavedMap
from tests.helpers.driven_maps import drive_poses, driven_map, town
from tests.slam.fleet.parts import CONFIG

FIRST, SECOND = (0.0, 150.0), (110.0, 40.0)


@pytest.fixture(scope="module")
def maps() -> list[SavedMap]:
    drives = enumerate((FIRST, SECOND))
    return [condense_map(driven_map(town(), *drive, seed=seed), CONFIG) for seed, drive in drives]


def test_a_place_is_found_in_the_map_that_has_it_and_with_its_landmarks(maps: list[SavedMap], tmp_path: Path) -> None:
    other = driven_map(town(7), 0.0, 100.0, seed=3)
    joins = find_joins(maps[1], [other, maps[0]], CONFIG)
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
    assert find_joins(maps[1], [twice], CONFIG) == []


def join(log_odds: float, *, query_map: int = 1) -> Join:
    nothing = np.zeros((0, 2), int)
    return Join(query_map, 0, 0, np.eye(4), np.eye(4), np.eye(6), log_odds, nothing)


def test_accept_joins_takes_all_joins_of_two_maps_that_the_surest_joins() -> None:
    joins = [join(20.0), join(5.0), join(3.0, query_map=2), join(30.0)]
    assert [each.log_odds for each in accept_joins(joins, 3, CONFIG)] == [20.0, 5.0, 30.0]


@pytest.mark.parametrize(("log_odds", "is_accepted"), [(10.9, False), (11.1, True)])
def test_all_pairs_of_maps_share_the_probability_of_an_error(log_odds: float, is_accepted: bool) -> None:
    """Of four maps there are six pairs: 9.2 nats for an error in 10,000, 1.8 for the pairs."""
    joins = [join(log_odds)]
    assert accept_joins(joins, 4, CONFIG) == joins[:is_accepted]
    assert ("less than 11.0" in why_alone(1, joins, 4, CONFIG)) is not is_accepted
    assert "none of its places" in why_alone(2, joins, 4, CONFIG)
