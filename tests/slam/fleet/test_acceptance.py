"""Which recognised places join two maps, with places that stand in the tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import invert, transform_from_xyz_yaw
from slam.fleet.acceptance import MapPair, judge_pairs, mean_drift, search_penalty
from slam.fleet.joins import Join
from slam.loop_closure.consistency import AGREE_RANGES
from slam.object_map.map_io import SavedMap
from tests.helpers.driven_maps import drive_poses, driven_map, town

CONFIG = Config()
FIRST, SECOND = (0.0, 250.0), (350.0, 100.0)
NEAR, MIDDLE, FAR = 70, 90, 110
"""Keyframes of the second map."""


@pytest.fixture(scope="module")
def maps() -> list[SavedMap]:
    world = town()
    return [driven_map(world, *FIRST, seed=1), driven_map(world, *SECOND, seed=2)]


@pytest.fixture(scope="module")
def T_first_second() -> FloatArray:
    world = town()
    return np.asarray(invert(drive_poses(world, *FIRST)[0]) @ drive_poses(world, *SECOND)[0])


def join(
    maps: list[SavedMap], T_reference_query: FloatArray, place: int, *, llr: float = 40.0, turn: float = 0.0
) -> Join:
    """A place of the second map that is recognised in the first where it is, but for a turn."""
    T_query_place = maps[1].graph.T_map_body[place]
    T = T_reference_query @ T_query_place @ transform_from_xyz_yaw(np.zeros(3), turn)
    return Join(1, 0, place, T_query_place, T, 0.01 * np.eye(6), llr, np.zeros((0, 2), dtype=np.int64))


def judged(maps: list[SavedMap], *joins: Join) -> MapPair:
    (pair,) = judge_pairs(maps, joins, CONFIG)
    return pair


def test_places_tell_one_transform(maps: list[SavedMap], T_first_second: FloatArray) -> None:
    pair = judged(maps, join(maps, T_first_second, NEAR), join(maps, T_first_second, FAR))
    assert pair.accepted
    assert len(pair.joins) == 2
    np.testing.assert_allclose(pair.T_first_second, T_first_second, atol=1e-9)


def test_a_landmark_counts_once_although_three_places_have_it(maps: list[SavedMap], T_first_second: FloatArray) -> None:
    joins = [join(maps, T_first_second, place, llr=12.0) for place in (NEAR, MIDDLE, FAR)]
    pair = judged(maps, *joins)
    assert len(pair.joins) == 3
    assert pair.log_odds == pytest.approx(12.0 - search_penalty(maps[0], maps[1], joins, CONFIG), abs=0.01)
    assert not pair.accepted


def test_the_better_poses_are_told_apart_the_more_evidence_a_join_needs(
    maps: list[SavedMap], T_first_second: FloatArray
) -> None:
    blurred = join(maps, T_first_second, NEAR)
    exact = replace(blurred, covariance=1e-2 * blurred.covariance)
    assert judged(maps, exact).log_odds == pytest.approx(judged(maps, blurred).log_odds - 3.0 * np.log(10.0), abs=1e-6)


def test_two_headings_at_one_place_are_two_transforms(maps: list[SavedMap], T_first_second: FloatArray) -> None:
    joins = join(maps, T_first_second, NEAR), join(maps, T_first_second, NEAR, turn=np.pi / 2.0)
    pair = judged(maps, *joins)
    assert not pair.accepted
    assert "another transform" in pair.reason


def test_maps_may_be_bent_by_their_drift_between_two_places(maps: list[SavedMap], T_first_second: FloatArray) -> None:
    places = maps[1].graph.T_map_body[:, :2, 3]
    apart_m = float(np.linalg.norm(places[FAR] - places[NEAR]))
    drift_m = float(np.sqrt(apart_m * sum(mean_drift(each)[0] for each in maps)))
    limit_m = AGREE_RANGES * CONFIG.sensor_range_m
    for shift_m, count in ((limit_m + 0.5 * drift_m, 2), (limit_m + 50.0, 1)):
        shifted = transform_from_xyz_yaw(np.array([shift_m, 0.0, 0.0]), 0.0) @ T_first_second
        pair = judged(maps, join(maps, T_first_second, NEAR), join(maps, shifted, FAR))
        assert len(pair.joins) == count


def test_all_pairs_of_maps_share_the_probability_of_an_error(maps: list[SavedMap], T_first_second: FloatArray) -> None:
    """Of four maps there are six pairs: 9.2 nats for an error in 10,000, 1.8 for the pairs."""
    four = [*maps, *maps]
    penalty = search_penalty(maps[0], maps[1], [join(maps, T_first_second, NEAR)], CONFIG)
    for surplus, is_accepted in ((10.9, False), (11.1, True)):
        pair = judged(four, join(maps, T_first_second, NEAR, llr=surplus + penalty))
        assert pair.accepted is is_accepted
        assert ("less than 11.0" in pair.reason) is not is_accepted
