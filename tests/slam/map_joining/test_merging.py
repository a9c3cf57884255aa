"""Maps cut apart and put together again, against the truth of the town that they are of."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.common.georeference import Georeference
from slam.final_map import FinalMap
from slam.localization.imported_map_editing import merge_imported_maps
from slam.map_joining.merging import MergedMap, merge_maps
from slam.object_map.map_io import SavedMap, confirmed, observing, of_rows
from slam.object_map.map_validation import find_fault
from slam.place_recognition.imported_map import ImportedMap, make_imported_map
from slam.simulation.config import SimulationConfig
from slam.system import Slam
from tests.helpers.short_drives import block_world, drive

pytestmark = pytest.mark.slow

T_AWAY = transform_from_xyz_yaw(np.array([400.0, -250.0, 3.0]), 2.0)
"""Where the frame of the second map lies."""


def moved(saved: SavedMap, T_new_old: FloatArray) -> SavedMap:
    """The map in another frame."""
    R = T_new_old[:3, :3]
    positions, covariances = apply(T_new_old, saved.objects.positions), R @ saved.objects.covariances @ R.T
    return replace(
        saved,
        objects=replace(saved.objects, positions=positions, covariances=covariances),
        graph=replace(saved.graph, T_map_body=T_new_old @ saved.graph.T_map_body),
    )


def mapped(seed: int) -> SavedMap:
    slam = Slam(Config())
    for _, _, record in drive(SimulationConfig(), seed=seed):
        slam.process(record)
    final: FinalMap = slam.finish()
    about = {"input_sha256": f"drive {seed}", "version": "test", "configuration": Config().model_dump_json()}
    return SavedMap(confirmed(final.object_map), final.graph, about, (about,))


@pytest.fixture(scope="module")
def first() -> SavedMap:
    return mapped(1)


@pytest.fixture(scope="module")
def second() -> SavedMap:
    """The same town by another drive, in a frame of its own."""
    return moved(mapped(2), T_AWAY)


def true_positions() -> np.ndarray:
    """In the frame of the first pose."""
    world = block_world()
    start = drive(SimulationConfig(), seed=1)
    T_world_map = next(record.T_world_body for _, _, record in start if hasattr(record, "T_world_body"))
    return apply(invert(T_world_map), world.positions)


def errors_m(saved: SavedMap) -> np.ndarray:
    """Distance (L,) m of each landmark to the nearest object of the town."""
    truth = true_positions()[:, :2]
    return np.linalg.norm(saved.objects.positions[:, None, :2] - truth[None], axis=2).min(axis=1)


def half(saved: SavedMap, low: float, high: float) -> SavedMap:
    """The part of a map in these quantiles of its landmarks along x, as the longest pass of the drive saw it."""
    x = np.quantile(saved.objects.positions[:, 0], [low, high])
    kept = of_rows(saved.objects, (saved.objects.positions[:, 0] >= x[0]) & (saved.objects.positions[:, 0] <= x[1]))
    at = saved.graph.T_map_body[:, 0, 3]
    outside = np.flatnonzero(np.concatenate([[True], (at < x[0]) | (at > x[1]), [True]]))
    longest = int(np.diff(outside).argmax())
    rows = np.arange(len(at))
    is_kept = (rows >= outside[longest]) & (rows < outside[longest + 1] - 1)
    return replace(saved, objects=kept, graph=observing(saved.graph, kept, is_kept))


def test_two_maps_of_one_town_become_one(first: SavedMap, second: SavedMap) -> None:
    merged = merge_maps([first, second])
    assert isinstance(merged, MergedMap)
    assert merged.recognised[1] > 3
    assert merged.repeated == ()
    count = len(merged.saved.objects.ids)
    assert merged.shared == len(first.objects.ids) + len(second.objects.ids) - count
    assert count <= 1.05 * max(len(first.objects.ids), len(second.objects.ids))
    assert np.median(errors_m(merged.saved)) <= 1.1 * np.median(errors_m(first))
    assert errors_m(merged.saved).max() < 1.0
    assert find_fault(merged.saved.objects, merged.saved.graph) == ""
    assert [drive["input_sha256"] for drive in merged.saved.drives] == ["drive 1", "drive 2"]


def test_maps_of_two_towns_are_not_joined(first: SavedMap) -> None:
    rng, count = np.random.default_rng(5), len(first.objects.ids)
    low, high = first.objects.positions[:, :2].min(axis=0), first.objects.positions[:, :2].max(axis=0)
    places = np.column_stack([rng.uniform(low, high, (count, 2)), np.zeros(count)])
    elsewhere = replace(first.objects, positions=places)
    seen = first.graph.observation_keyframe_ids
    row_of = {name: row for row, name in enumerate(elsewhere.ids)}
    pose_of = {int(k): row for row, k in enumerate(first.graph.keyframe_ids)}
    positions = np.array(
        [
            apply(invert(first.graph.T_map_body[pose_of[int(keyframe)]]), elsewhere.positions[row_of[name]][None])[0]
            for keyframe, name in zip(seen, first.graph.observation_landmark_ids, strict=True)
        ]
    )
    other = SavedMap(elsewhere, replace(first.graph, observation_positions=positions), first.metadata, first.drives)
    assert merge_maps([first, other]) == [1]


def georeferenced(saved: SavedMap, georeference: Georeference) -> SavedMap:
    return replace(saved, metadata={**saved.metadata, "georeference": georeference.to_json()})


def test_georeferences_join_maps_that_share_no_place(first: SavedMap, second: SavedMap) -> None:
    """Two ends of the town; each lies where it does on earth."""
    left, right = half(first, 0.0, 0.3), half(moved(second, invert(T_AWAY)), 0.7, 1.0)
    assert merge_maps([left, right]) == [1]
    here = Georeference(60.17, 24.94, 12.0, 0.3)
    origin = here.to_geodetic(invert(T_AWAY)[None, :3, 3])[0]
    there = Georeference(*origin.tolist(), yaw_rad=0.3 - 2.0)
    merged = merge_maps([georeferenced(left, here), georeferenced(moved(right, T_AWAY), there)])
    assert isinstance(merged, MergedMap)
    assert merged.recognised == (0, 0)
    assert len(merged.saved.objects.ids) == len(left.objects.ids) + len(right.objects.ids)
    assert errors_m(merged.saved).max() < 2.0
    assert merged.saved.georeference == here
    assert find_fault(merged.saved.objects, merged.saved.graph) == ""


def city(origin: Georeference, positions: np.ndarray, ids: list[str]) -> ImportedMap:
    labels = ["tree" if row % 2 else "lamp" for row in range(len(ids))]
    return make_imported_map(positions, labels, ids, sigma_m=0.3, georeference=origin)


def test_imported_maps_are_joined_by_their_georeferences() -> None:
    rng = np.random.default_rng(4)
    objects = np.column_stack([rng.uniform(0.0, 300.0, (60, 2)), np.zeros(60)])
    here = Georeference(52.0, 13.0)
    there = Georeference(52.0 + 100.0 / 111_000.0, 13.0 + 50.0 / 111_000.0 / cos(radians(52.0)))
    ids = [f"n{row}" for row in range(60)]
    whole = city(here, objects, ids)
    in_there = there.to_map(here.to_geodetic(objects[20:]))
    merged = merge_imported_maps(city(here, objects[:40], ids[:40]), city(there, in_there, ids[20:]))
    assert len(merged) == len(whole)
    order, known = np.argsort(merged.positions[:, 0]), np.argsort(whole.positions[:, 0])
    np.testing.assert_allclose(merged.positions[order, :2], whole.positions[known, :2], atol=0.01)
    with pytest.raises(SavedMapError, match="--origin"):
        merge_imported_maps(whole, replace(whole, georeference=None))


def test_a_drive_that_is_in_two_maps_is_told(first: SavedMap) -> None:
    merged = merge_maps([first, half(first, 0.0, 0.6)])
    assert isinstance(merged, MergedMap)
    assert merged.repeated == ("drive 1",)
