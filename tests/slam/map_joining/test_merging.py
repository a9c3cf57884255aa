"""Maps cut apart and put together again, against the truth of the town that they are of."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians
from pathlib import Path

import numpy as np
import pytest

from slam.common.areas import Area, Circle, Polygon
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.common.georeference import Georeference
from slam.final_map import FinalMap
from slam.localization.imported_map_editing import crop_imported_map, merge_imported_maps
from slam.map_joining.merging import MergedMap, merge_maps
from slam.object_map.map_cropping import crop_map
from slam.object_map.map_io import SavedMap, confirmed, load_map, write_map
from slam.object_map.map_validation import find_fault
from slam.place_recognition.imported_map import ImportedMap, make_imported_map
from slam.simulation.config import SimulationConfig
from slam.system import Slam
from tests.helpers.short_drives import block_world, drive

pytestmark = pytest.mark.slow

T_AWAY = transform_from_xyz_yaw(np.array([400.0, -250.0, 3.0]), 2.0)
"""Where the frame of the second map lies."""


def box(x0: float, y0: float, x1: float, y1: float) -> Polygon:
    return Polygon(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))


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
    """The part of a map in these quantiles of its landmarks along x."""
    x = np.quantile(saved.objects.positions[:, 0], [low, high])
    return crop_map(saved, box(x[0] - 0.1, -1e4, x[1] + 0.1, 1e4))


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


@pytest.mark.parametrize("area", [Circle(30.0, 20.0, 35.0), box(-20.0, -20.0, 50.0, 30.0)])
def test_a_part_holds_what_lies_in_it_where_it_was(first: SavedMap, area: Area, tmp_path: Path) -> None:
    part = crop_map(first, area)
    inside = area.contains(first.objects.positions)
    assert 0 < inside.sum() < len(inside)
    np.testing.assert_array_equal(part.objects.positions, first.objects.positions[inside])
    at_keyframes = first.graph.T_map_body[:, :3, 3]
    np.testing.assert_array_equal(part.graph.T_map_body[:, :3, 3], at_keyframes[area.contains(at_keyframes)])
    assert set(part.graph.observation_landmark_ids) <= set(part.objects.ids)
    write_map(tmp_path / "part.mcap", part)
    back = load_map(tmp_path / "part.mcap")
    np.testing.assert_array_equal(back.objects.positions, part.objects.positions)
    assert len(back.graph.keyframe_ids) == len(part.graph.keyframe_ids)
    assert [drive["input_sha256"] for drive in back.drives] == ["drive 1"]


def test_what_lay_between_two_parts_becomes_an_edge(first: SavedMap) -> None:
    """Two opposite sides of the block: the drive left the area and came back."""
    x = first.graph.T_map_body[:, 0, 3]
    low, high = np.quantile(x, [0.3, 0.7])
    outer = [[-1e3, 1e3], [-1e3, -1e3], [1e3, -1e3], [1e3, 1e3]]
    notch = [[high, 1e3], [high, -999], [low, -999], [low, 1e3]]
    ring = np.array([*outer, *notch])
    part = crop_map(first, Polygon(ring))
    assert find_fault(part.objects, part.graph) == ""
    new = len(part.graph.edge_kinds) - sum(
        set(ends) <= set(part.graph.keyframe_ids.tolist()) for ends in first.graph.edge_keyframe_ids.tolist()
    )
    assert new >= 1
    row_of = {int(keyframe): row for row, keyframe in enumerate(part.graph.keyframe_ids)}
    for (a, b), T, P in list(
        zip(part.graph.edge_keyframe_ids, part.graph.edge_transforms, part.graph.edge_covariances, strict=True)
    )[-new:]:
        T_a, T_b = (part.graph.T_map_body[row_of[int(k)]] for k in (a, b))
        np.testing.assert_allclose(T, invert(T_a) @ T_b, atol=1e-9)
        # No surer than one step, and less sure than any of them.
        assert np.trace(P[3:, 3:]) > 5 * np.median(np.trace(first.graph.edge_covariances[:, 3:, 3:], axis1=1, axis2=2))


def test_an_area_beside_the_map_is_refused(first: SavedMap) -> None:
    with pytest.raises(SavedMapError, match=r"0 of .* landmarks"):
        crop_map(first, Circle(1e4, 0.0, 10.0))


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


def test_a_part_of_an_imported_map() -> None:
    objects = np.column_stack([np.repeat(np.arange(10.0), 10), np.tile(np.arange(10.0), 10), np.zeros(100)]) * 20.0
    whole = city(Georeference(52.0, 13.0), objects, [str(row) for row in range(100)])
    part = crop_imported_map(whole, Circle(0.0, 0.0, 45.0))
    assert sorted(map(tuple, part.positions[:, :2].tolist())) == [
        (0.0, 0.0), (0.0, 20.0), (0.0, 40.0), (20.0, 0.0), (20.0, 20.0), (20.0, 40.0), (40.0, 0.0), (40.0, 20.0)
    ]  # fmt: skip
    assert part.georeference == whole.georeference
    with pytest.raises(SavedMapError, match="0 of 100 objects"):
        crop_imported_map(whole, Circle(1e4, 0.0, 10.0))


def test_a_drive_that_is_in_two_maps_is_told(first: SavedMap) -> None:
    merged = merge_maps([first, half(first, 0.0, 0.6)])
    assert isinstance(merged, MergedMap)
    assert merged.repeated == ("drive 1",)
