"""Which recognised places join two maps, with places that stand in the tests."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import invert, transform_from_xyz_yaw
from slam.loop_closure.consistency import AGREE_RANGES
from slam.map_joining.acceptance import MapPair, judge_pairs
from slam.map_joining.joins import Join, mean_drift
from slam.object_map.map_io import SavedMap
from tests.helpers.driven_maps import drive_poses, driven_map, town

CONFIG = Config()
FIRST, SECOND = (0.0, 250.0), (350.0, 100.0)
NEAR, MIDDLE, FAR = 70, 90, 110
"""Keyframes of the first map."""


@pytest.fixture(scope="module")
def maps() -> list[SavedMap]:
    world = town()
    return [driven_map(world, *FIRST, seed=1), driven_map(world, *SECOND, seed=2)]


@pytest.fixture(scope="module")
def T_second_first() -> FloatArray:
    world = town()
    return np.asarray(invert(drive_poses(world, *SECOND)[0]) @ drive_poses(world, *FIRST)[0])


def join(
    maps: list[SavedMap],
    T_reference_query: FloatArray,
    place: int,
    *,
    llr: float = 40.0,
    query: int = 0,
    turn: float = 0.0,
) -> Join:
    """A place that is recognised where it is, but for a turn."""
    T = T_reference_query @ maps[query].graph.T_map_body[place] @ transform_from_xyz_yaw(np.zeros(3), turn)
    return Join(query, place, 1 - query, T, 0.01 * np.eye(6), llr, 8)


def judged(maps: list[SavedMap], *joins: Join) -> MapPair:
    (pair,) = judge_pairs(maps, joins, CONFIG, penalty=6.0)
    return pair


def test_places_of_both_maps_tell_one_transform(maps: list[SavedMap], T_second_first: FloatArray) -> None:
    joins = join(maps, T_second_first, NEAR), join(maps, invert(T_second_first), 40, query=1)
    pair = judged(maps, *joins)
    assert pair.accepted
    assert len(pair.joins) == 2


def test_a_landmark_counts_once_although_three_places_have_it(maps: list[SavedMap], T_second_first: FloatArray) -> None:
    joins = [join(maps, T_second_first, place, llr=12.0) for place in (NEAR, MIDDLE, FAR)]
    pair = judged(maps, *joins)
    assert len(pair.joins) == 3
    assert pair.log_odds == pytest.approx(6.0, abs=0.01)
    assert not pair.accepted


def test_two_headings_at_one_place_are_two_transforms(maps: list[SavedMap], T_second_first: FloatArray) -> None:
    joins = join(maps, T_second_first, NEAR), join(maps, T_second_first, NEAR, turn=np.pi / 2.0)
    pair = judged(maps, *joins)
    assert not pair.accepted
    assert "another transform" in pair.reason


def test_maps_may_be_bent_by_their_drift_between_two_places(maps: list[SavedMap], T_second_first: FloatArray) -> None:
    places = maps[0].graph.T_map_body[:, :2, 3]
    apart_m = float(np.linalg.norm(places[FAR] - places[NEAR]))
    drift_m = float(np.sqrt(apart_m * sum(mean_drift(each)[0] for each in maps)))
    limit_m = AGREE_RANGES * CONFIG.sensor_range_m
    for shift_m, count in ((limit_m + 0.5 * drift_m, 2), (limit_m + 50.0, 1)):
        shifted = transform_from_xyz_yaw(np.array([shift_m, 0.0, 0.0]), 0.0) @ T_second_first
        pair = judged(maps, join(maps, T_second_first, NEAR), join(maps, shifted, FAR))
        assert len(pair.joins) == count


def test_all_pairs_of_maps_share_the_probability_of_an_error(maps: list[SavedMap], T_second_first: FloatArray) -> None:
    """Of four maps there are six pairs: 9.2 nats for an error in 10,000, 1.8 for the pairs, 6 for the search."""
    four = [*maps, *maps]
    for llr, is_accepted in ((16.9, False), (17.1, True)):
        pair = judged(four, join(maps, T_second_first, NEAR, llr=llr))
        assert pair.accepted is is_accepted
        assert ("less than 11.0" in pair.reason) is not is_accepted
