from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.map_joining.acceptance import MapPair, judge_pairs
from slam.map_joining.condensed_map import condense_map
from slam.map_joining.joins import Join, find_joins
from slam.map_joining.joint_map import join_parts
from slam.map_joining.part import Part, session_part
from slam.map_joining.place_index import make_place_index
from slam.object_map.map_io import SavedMap
from tests.helpers.driven_maps import drive_poses, driven_map, town

pytestmark = pytest.mark.slow

CONFIG = Config()
DRIVES = ((0.0, 250.0), (350.0, 100.0), (300.0, 500.0))


def condensed_maps() -> list[SavedMap]:
    world = town()
    maps = [driven_map(world, *drive, seed=seed) for seed, drive in enumerate(DRIVES)]
    maps.append(driven_map(town(7), 0.0, 200.0, seed=9))  # of another town
    return [condense_map(each, stretch_m=25.0) for each in maps]


def all_joins(maps: list[SavedMap]) -> list[Join]:
    index = make_place_index(maps, sigma_m=CONFIG.calibration.objects.landmark_sigma_m)
    return [join for number, each in enumerate(maps) for join in find_joins(each, number, index, CONFIG)]


@pytest.fixture(scope="module")
def maps() -> list[SavedMap]:
    return condensed_maps()


@pytest.fixture(scope="module")
def joins(maps: list[SavedMap]) -> list[Join]:
    return all_joins(maps)


@pytest.fixture(scope="module")
def pairs(maps: list[SavedMap], joins: list[Join]) -> list[MapPair]:
    return judge_pairs(maps, joins, CONFIG, penalty=6.0)


@pytest.fixture(scope="module")
def joint(maps: list[SavedMap], pairs: list[MapPair]) -> list[Part]:
    return join_parts([session_part(*each) for each in enumerate(maps)], pairs, CONFIG)


def truth(reference: int, query: int) -> np.ndarray:
    """T_reference_query of the frames of two maps of the town."""
    first = [drive_poses(town(), *drive)[0] for drive in DRIVES]
    return np.asarray(invert(first[reference]) @ first[query])


def test_places_are_found_where_they_are(maps: list[SavedMap], pairs: list[MapPair]) -> None:
    accepted = [pair for pair in pairs if pair.accepted]
    assert {(pair.first, pair.second) for pair in accepted} == {(0, 1), (1, 2)}
    for pair in accepted:
        for join in pair.joins:
            expected = truth(join.reference_map, join.query_map) @ maps[join.query_map].graph.T_map_body[join.place]
            assert np.linalg.norm(join.T_reference_place[:2, 3] - expected[:2, 3]) < 0.5


def test_maps_of_one_town_become_one_and_the_other_town_stays_alone(joint: list[Part]) -> None:
    assert [part.sessions for part in joint] == [(0, 1, 2), (3,)]


def test_landmarks_are_fused_and_nearer_to_the_truth(joint: list[Part], maps: list[SavedMap]) -> None:
    world, part = town(), joint[0]
    distinct = {name for each in maps[:3] for name in each.objects.ids}
    assert 0.99 * len(distinct) <= len(part.objects.ids) <= 1.01 * len(distinct)
    T_first_world = invert(drive_poses(world, *DRIVES[0])[0])
    true_of = dict(zip(world.object_ids, apply(T_first_world, world.positions), strict=True))
    true = np.array([true_of[name] for name in sorted(distinct)])
    errors, nearest = cKDTree(true[:, :2]).query(part.objects.positions[:, :2])
    assert np.median(errors) < 0.3
    seen_in = [{number for number in range(3) if name in maps[number].objects.ids} for name in sorted(distinct)]
    rows = zip(part.objects.ids, nearest, strict=True)
    matched = [seen_in[row] == set(part.seen[name]) for name, row in rows]
    assert np.mean(matched) > 0.98


def test_a_false_pair_is_rejected_by_the_others(maps: list[SavedMap], pairs: list[MapPair]) -> None:
    """Maps 0 and 2 joined far from where the chain over 1 puts them."""
    template = next(pair for pair in pairs if (pair.first, pair.second) == (0, 1)).joins[0]
    T = np.eye(4)
    T[:2, 3] = [400.0, 300.0]
    false = replace(template, query_map=0, reference_map=2, T_reference_place=T, llr=30.0)
    lie = MapPair(0, 2, (false,), 25.0, True, "")
    parts = join_parts([session_part(*each) for each in enumerate(maps)], [*pairs, lie], CONFIG)
    assert parts[0].sessions == (0, 1, 2)
    assert parts[0].rejected == (false,)
