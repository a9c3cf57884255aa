from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.common.geometry import apply, invert
from slam.fleet.joins import Join, accept_joins
from slam.fleet.joint_map import join_parts
from slam.fleet.part import Part
from tests.helpers.driven_maps import drive_poses, driven_map, town
from tests.helpers.poses import pose_at
from tests.slam.fleet.parts import CONFIG, joins_of, session_parts

pytestmark = pytest.mark.slow

DRIVES = ((0.0, 250.0), (350.0, 100.0), (300.0, 500.0))


@pytest.fixture(scope="module")
def parts() -> list[Part]:
    maps = [driven_map(town(), *drive, seed=seed) for seed, drive in enumerate(DRIVES)]
    return session_parts([*maps, driven_map(town(7), 0.0, 200.0, seed=9)])  # the last one of another town


@pytest.fixture(scope="module")
def joins(parts: list[Part]) -> list[Join]:
    return accept_joins(joins_of(parts), len(parts), CONFIG)


@pytest.fixture(scope="module")
def joint(parts: list[Part], joins: list[Join]) -> list[Part]:
    return join_parts(parts, joins, CONFIG)


def test_maps_of_one_town_become_one_and_the_other_town_stays_alone(joint: list[Part], parts: list[Part]) -> None:
    assert [part.sessions for part in joint] == [(0, 1, 2), (3,)]
    assert joint[1].saved is parts[3].saved


def test_landmarks_are_fused_and_nearer_to_the_truth(joint: list[Part], parts: list[Part]) -> None:
    world, part = town(), joint[0]
    names = [set(each.objects.ids) for each in parts[:3]]
    distinct = sorted(set().union(*names))
    assert 0.99 * len(distinct) <= len(part.objects.ids) <= 1.01 * len(distinct)
    T_first_world = invert(drive_poses(world, *DRIVES[0])[0])
    true_of = dict(zip(world.object_ids, apply(T_first_world, world.positions), strict=True))
    errors, nearest = cKDTree([true_of[name][:2] for name in distinct]).query(part.objects.positions[:, :2])
    assert np.median(errors) < 0.3
    is_seen = [np.isin(np.arange(len(nearest)), part.visits[number].landmarks) for number in range(3)]
    is_true = [[distinct[row] in each for row in nearest.tolist()] for each in names]
    assert np.equal(is_seen, is_true).all(axis=0).mean() > 0.98


def test_landmarks_that_no_join_matched_are_fused_where_their_offset_is_noise(joint, parts, joins):
    unmatched = [replace(join, pairs=join.pairs[:0]) for join in joins]
    found, matched = (len(each[0].objects.ids) for each in (join_parts(parts, unmatched, CONFIG), joint))
    assert matched <= found <= 1.02 * matched


def test_maps_whose_joins_all_contradict_the_solution_stay_alone(
    parts: list[Part], joins: list[Join], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.fleet.joint_map.MAX_DEVIATIONS", 0.0)
    assert [part.sessions for part in join_parts(parts, joins, CONFIG)] == [(0,), (1,), (2,), (3,)]


def test_a_false_pair_is_rejected_by_the_others(joint: list[Part], parts: list[Part], joins: list[Join]) -> None:
    """Maps 0 and 2 joined far from where the chain over 1 puts them."""
    template = next(join for join in joins if (join.reference_map, join.query_map) == (0, 1))
    far = pose_at(400.0, 300.0)
    false = replace(template, reference_map=0, query_map=2, T_reference_place=far, log_odds=30.0)
    found = join_parts(parts, [*joins, false], CONFIG)[0]
    assert found.sessions == (0, 1, 2)
    np.testing.assert_allclose(found.objects.positions, joint[0].objects.positions, atol=0.05)
