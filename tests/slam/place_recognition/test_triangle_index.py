"""Triangles find where a query is in a forest, where all objects are of one class."""

from __future__ import annotations

import numpy as np
import pytest

import slam.place_recognition.triangle_index as triangle_index
from slam.common.geometry import apply, invert, transform_from_xyz_yaw, yaw_rad
from slam.place_recognition.triangle_index import TriangleIndex
from slam.place_recognition.triangle_voting import VotedPose, vote_for_poses
from slam.place_recognition.triangles import neighbour_triangles

TOLERANCE_M = 0.3
SPACING_M = 3.0


def forest(count: int, *, seed: int) -> np.ndarray:
    """Stems (N, 3) m at random, about ``SPACING_M`` apart, on uneven ground."""
    rng = np.random.default_rng(seed)
    side_m = SPACING_M * np.sqrt(count)
    return np.column_stack([rng.uniform(0.0, side_m, (count, 2)), rng.normal(0.0, 0.2, count)])


def index_of(positions: np.ndarray, labels: np.ndarray | None = None) -> TriangleIndex:
    index = TriangleIndex(TOLERANCE_M)
    rows = np.arange(len(positions))
    index.add(positions, np.zeros(len(rows), np.int64) if labels is None else labels, rows, rows)
    return index


def seen_from(positions: np.ndarray, T_map_query: np.ndarray, *, seed: int, found: float = 0.64) -> np.ndarray:
    """What a sensor at a pose sees within 15 m: some of the stems, with noise, and as many others."""
    rng = np.random.default_rng(seed)
    local = apply(invert(T_map_query), positions)
    local = local[np.hypot(local[:, 0], local[:, 1]) < 15.0]
    kept = local[rng.random(len(local)) < found] + 0.0
    kept += rng.normal(0.0, 0.08, kept.shape)
    others = np.column_stack([rng.uniform(-15.0, 15.0, (len(local) - len(kept), 2)), np.zeros(len(local) - len(kept))])
    return np.concatenate([kept, others])


def places_of(index: TriangleIndex, stems: np.ndarray, query: np.ndarray, *, count: int = 3) -> list[VotedPose]:
    matches = index.match(query, np.zeros(len(query), np.int64), np.ones(len(stems), bool))
    return vote_for_poses(query, stems, matches, tolerance_m=TOLERANCE_M, count=count)


def is_at(pose: VotedPose, T_map_query: np.ndarray) -> bool:
    off = invert(T_map_query) @ pose.T_reference_query
    return bool(np.hypot(*off[:2, 3]) < 0.5 and abs(float(yaw_rad(off))) < np.deg2rad(3.0))


@pytest.fixture(scope="module")
def stems() -> np.ndarray:
    return forest(3000, seed=0)


@pytest.fixture(scope="module")
def index(stems) -> TriangleIndex:
    return index_of(stems)


def test_a_scan_of_stems_finds_its_place_from_any_direction(stems, index):
    found = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        T = transform_from_xyz_yaw(np.array([*rng.uniform(20.0, 140.0, 2), 0.3]), rng.uniform(-np.pi, np.pi))
        found += is_at(places_of(index, stems, seen_from(stems, T, seed=seed))[0], T)
    assert found >= 19


def test_twin_stems_that_are_all_new_have_few_votes(stems, index):
    T = transform_from_xyz_yaw(np.array([70.0, 80.0, 0.0]), 1.0)
    right = places_of(index, stems, seen_from(stems, T, seed=1))[0]
    wrong = places_of(index, stems, seen_from(stems, T, seed=1, found=0.0))[0]
    assert len(wrong.matches) < 0.5 * len(right.matches)
    assert not is_at(wrong, T)


def test_the_place_has_the_height_of_the_matched_objects(stems, index):
    T = transform_from_xyz_yaw(np.array([70.0, 80.0, 5.0]), 1.0)
    assert places_of(index, stems, seen_from(stems, T, seed=1))[0].T_reference_query[2, 3] == pytest.approx(
        5.0, abs=0.3
    )


def test_places_are_distinct(stems, index):
    T = transform_from_xyz_yaw(np.array([70.0, 80.0, 0.0]), 1.0)
    first, *others = places_of(index, stems, seen_from(stems, T, seed=1), count=5)
    assert is_at(first, T)
    assert not any(is_at(each, T) for each in others)


def test_objects_that_are_not_usable_are_not_matched(stems, index):
    T = transform_from_xyz_yaw(np.array([70.0, 80.0, 0.0]), 1.0)
    query = seen_from(stems, T, seed=1)
    usable = np.hypot(*(stems[:, :2] - [70.0, 80.0]).T) > 20.0
    matches = index.match(query, np.zeros(len(query), np.int64), usable)
    assert len(matches) > 0
    assert usable[matches.reference].all()


def test_classes_must_agree():
    positions = forest(30, seed=2)
    labels = np.arange(30) % 3
    index = index_of(positions, labels)
    everything = np.ones(30, bool)
    assert len(index.match(positions, labels, everything)) >= len(neighbour_triangles(positions))
    others = index.match(positions, np.full(30, 3), everything)
    assert len(others) == 0


def test_mirror_images_do_not_match():
    positions = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 5.0, 0.0]])
    labels = np.zeros(3, np.int64)
    index = index_of(positions)
    assert len(index.match(positions, labels, np.ones(3, bool))) == 1
    assert len(index.match(positions * [1.0, -1.0, 1.0], labels, np.ones(3, bool))) == 0


def test_sides_may_differ_by_the_tolerance_and_no_more():
    positions = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 5.0, 0.0]])
    index = index_of(positions)
    for factor, count in ((1.0 + 0.99 * TOLERANCE_M / np.sqrt(34.0), 1), (1.0 + 1.01 * TOLERANCE_M / np.sqrt(34.0), 0)):
        assert len(index.match(positions * factor, np.zeros(3, np.int64), np.ones(3, bool))) == count


def test_the_triangles_that_tell_most_are_compared_where_there_are_too_many(stems, index, monkeypatch):
    T = transform_from_xyz_yaw(np.array([70.0, 80.0, 0.0]), 1.0)
    query = seen_from(stems, T, seed=1)
    labels, everything = np.zeros(len(query), np.int64), np.ones(len(stems), bool)
    before = index.match(query, labels, everything)
    monkeypatch.setattr(triangle_index, "BUDGET", 20_000)
    after = index.match(query, labels, everything)
    assert 0 < len(after) < min(len(before), 20_000)
    assert is_at(vote_for_poses(query, stems, after, tolerance_m=TOLERANCE_M, count=1)[0], T)


def test_additions_in_parts_are_the_same_index(stems):
    whole = index_of(stems[:200])
    parts = TriangleIndex(TOLERANCE_M)
    rows = np.arange(200)
    for part in (np.arange(120), np.arange(120, 200)):
        parts.add(stems[:200], np.zeros(200, np.int64), rows, part)
    labels, everything = np.zeros(200, np.int64), np.ones(200, bool)
    a = whole.match(stems[:200], labels, everything)
    b = parts.match(stems[:200], labels, everything)
    assert {tuple(sorted(row)) for row in a.reference.tolist()} == {tuple(sorted(row)) for row in b.reference.tolist()}


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_objects_have_no_triangles(index, stems, count):
    few = stems[:count]
    assert len(neighbour_triangles(few)) == 0
    assert len(index_of(few)) == 0
    assert places_of(index, stems, few) == []


def test_triangles_are_unique_and_their_sides_ascend():
    triangles = neighbour_triangles(forest(100, seed=3))
    assert len(np.unique(np.sort(triangles.vertices, axis=1), axis=0)) == len(triangles)
    assert (np.diff(triangles.sides, axis=1) >= 0.0).all()


def test_objects_at_one_position_make_no_triangle_with_themselves():
    positions = np.repeat(forest(5, seed=4), 3, axis=0)
    vertices = neighbour_triangles(positions).vertices
    assert (np.diff(np.sort(vertices, axis=1), axis=1) > 0).all()
