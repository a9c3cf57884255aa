from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.common.georeference import Georeference
from slam.fleet.changes import Change, detect_changes, write_changes
from slam.map_joining.acceptance import judge_pairs
from slam.map_joining.condensed_map import condense_map
from slam.map_joining.joins import find_joins
from slam.map_joining.joint_map import join_parts
from slam.map_joining.part import session_part
from slam.map_joining.place_index import make_place_index
from slam.simulation.world import World
from tests.helpers.driven_maps import drive_poses, driven_map, town, without

MONTH_NS = 30 * 86_400 * 10**9
CONFIG = Config()
FROM_M, TO_M = 0.0, 150.0
MONTHS = 6
CHANGE_MONTH = 3


def objects_beside(world: World) -> list[int]:
    """Rows of objects near the middle of the drive, none of its class near another, nearest first."""
    path = drive_poses(world, FROM_M, TO_M)[20:-20, :2, 3]
    distances_m = np.hypot(*(world.positions[:, None, :2] - path[None]).transpose(2, 0, 1)).min(axis=1)
    labels = np.array(world.labels)
    alone = []
    for row in np.argsort(distances_m).tolist():
        alike = np.flatnonzero(labels == labels[row])
        apart_m = np.hypot(*(world.positions[alike, :2] - world.positions[row, :2]).T)
        if np.sort(apart_m)[1:2].min(initial=np.inf) > 8.0:
            alone.append(row)
    return alone


@pytest.fixture(scope="module")
def story() -> tuple[World, World, int, int, int]:
    """The town before and after: one object goes, one comes, one moves by 4 m."""
    before = town()
    gone, comes, moves = objects_beside(before)[:3]
    names = before.object_ids
    after = without(before, {names[gone]})
    positions = after.positions.copy()
    positions[after.object_ids.index(names[moves]), 0] += 4.0
    after = replace(after, positions=positions)
    return without(before, {names[comes]}), after, gone, comes, moves


@pytest.fixture(scope="module")
def changes(story: tuple[World, World, int, int, int]) -> tuple[Change, ...]:
    before, after, *_ = story
    maps = [
        condense_map(
            driven_map(before if month < CHANGE_MONTH else after, FROM_M, TO_M, seed=month, stamp_ns=month * MONTH_NS),
            stretch_m=25.0,
        )
        for month in range(MONTHS)
    ]
    index = make_place_index(maps, sigma_m=CONFIG.calibration.objects.landmark_sigma_m)
    joins = [join for number, each in enumerate(maps) for join in find_joins(each, number, index, CONFIG)]
    sessions = [session_part(month, saved) for month, saved in enumerate(maps)]
    (part,) = join_parts(sessions, judge_pairs(maps, joins, CONFIG, penalty=6.0), CONFIG)
    return detect_changes(part, [month * MONTH_NS for month in range(MONTHS)]).changes


@pytest.mark.slow
def test_what_went_came_and_moved_is_told_with_place_and_dates(
    story: tuple[World, World, int, int, int], changes: tuple[Change, ...]
) -> None:
    world = town()
    _, _, gone, comes, moves = story
    T_map_world = invert(drive_poses(world, FROM_M, TO_M)[0])
    place = apply(T_map_world, world.positions)
    assert sorted(change.kind for change in changes) == ["appeared", "gone", "moved"]
    by_kind = {change.kind: change for change in changes}
    for kind, row in (("gone", gone), ("appeared", comes)):
        assert by_kind[kind].label == world.labels[row]
        assert np.hypot(*(np.array(by_kind[kind].position) - place[row])[:2]) < 0.5
    moved = by_kind["moved"]
    assert moved.from_position is not None
    assert np.hypot(*(np.array(moved.from_position) - place[moves])[:2]) < 0.5
    assert abs(np.hypot(*(np.array(moved.position) - np.array(moved.from_position))[:2]) - 4.0) < 0.5
    for change in changes:
        assert change.probability > 0.9
        # Days 60 and 90 after 1970-01-01.
        assert change.after <= "1970-03-02T00:00:00+00:00"
        assert change.before >= "1970-04-01T00:00:00+00:00"


def test_changes_are_points_on_earth_where_the_origin_is_known(changes: tuple[Change, ...], tmp_path: Path) -> None:
    write_changes(tmp_path / "changes.geojson", changes, Georeference(60.0, 25.0))
    features = json.loads((tmp_path / "changes.geojson").read_text())["features"]
    assert len(features) == len(changes)
    assert all(abs(f["geometry"]["coordinates"][0] - 25.0) < 0.02 for f in features)
    assert all(abs(f["geometry"]["coordinates"][1] - 60.0) < 0.02 for f in features)


def test_without_an_origin_they_are_metres_of_the_map_and_say_so(changes: tuple[Change, ...], tmp_path: Path) -> None:
    write_changes(tmp_path / "changes.geojson", changes, None)
    collection = json.loads((tmp_path / "changes.geojson").read_text())
    assert collection["coordinates"] == "metres in the frame of the map"
    np.testing.assert_allclose(collection["features"][0]["geometry"]["coordinates"], changes[0].position, atol=1e-3)
