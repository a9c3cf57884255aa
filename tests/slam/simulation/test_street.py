"""The long street: as many objects and classes as it says, beside a tour of its length, the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.simulation.street import ROWS, generate_street
from slam.simulation.world import World


@pytest.fixture(scope="module", params=range(6))
def street(request: pytest.FixtureRequest) -> World:
    return generate_street(rng=np.random.default_rng(request.param))


def test_same_seed_same_street_other_seed_other_street() -> None:
    first, again, other = (generate_street(rng=np.random.default_rng(seed)).sha256() for seed in (7, 7, 8))
    assert first == again
    assert first != other


def test_it_has_its_objects_and_classes_under_ids_of_their_own(street: World) -> None:
    assert len(street.positions) == len(street.labels) == len(set(street.object_ids)) == 795
    assert len(street.vocabulary) == 25
    assert set(ROWS) < set(street.vocabulary)


def test_any_seed_gives_a_street() -> None:
    for seed in (*range(50), 758):  # the rows that are drawn with the last one leave out a class
        assert len(generate_street(rng=np.random.default_rng(seed)).vocabulary) == 25


def test_the_tour_has_its_length_in_steps_of_a_metre_and_bends_gently(street: World) -> None:
    assert street.tour_length_m == pytest.approx(1150.0, abs=1e-6)
    steps = np.diff(street.tour, axis=0)
    assert np.linalg.norm(steps, axis=1) == pytest.approx(1.0, abs=1e-9)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    assert np.abs(np.diff(headings)).max() < 0.02
    assert np.ptp(headings) > 0.2


def test_objects_stand_beside_the_roadway_and_no_farther_than_the_facades(street: World) -> None:
    distance_m, _ = cKDTree(street.tour).query(street.positions[:, :2])
    assert distance_m.min() > 3.5
    assert distance_m.max() < 11.5


def test_objects_stand_on_both_sides_and_all_along(street: World) -> None:
    _, nearest = cKDTree(street.tour).query(street.positions[:, :2])
    forward = np.diff(street.tour, axis=0)[np.minimum(nearest, len(street.tour) - 2)]
    offsets = street.positions[:, :2] - street.tour[nearest]
    left = np.mean(forward[:, 0] * offsets[:, 1] - forward[:, 1] * offsets[:, 0] > 0.0)
    assert 0.35 < left < 0.65
    per_stretch = np.bincount(nearest // 115, minlength=10)[:10]
    assert per_stretch.min() > 30


def test_rows_have_even_spacing_and_a_third_of_the_objects(street: World) -> None:
    labels = np.array(street.labels)
    share = np.mean(np.isin(labels, list(ROWS)))
    assert 0.35 <= share < 0.4
    for name, spacing_m in ROWS.items():
        # In the order in which they were made; a step to the next row has another length.
        steps_m = np.linalg.norm(np.diff(street.positions[labels == name, :2], axis=0), axis=1)
        assert np.mean(np.abs(steps_m - spacing_m) < 2.0) > 0.4


def test_classes_are_from_frequent_to_rare(street: World) -> None:
    counts = np.array([street.labels.count(f"class_{number:02d}") for number in range(22)])
    assert counts.min() >= 1
    assert counts[0] > 2.0 * counts[4] > 2.0 * counts[21]
    expected = counts.sum() / np.arange(1, 23) / np.sum(1.0 / np.arange(1, 23))
    assert np.abs(counts - expected).max() < 5.0 * np.sqrt(expected.max())


def test_a_class_has_its_height(street: World) -> None:
    heights = {label: street.positions[np.array(street.labels) == label, 2] for label in street.vocabulary}
    assert max(np.ptp(z) for z in heights.values()) < 1.0
    means = np.array([z.mean() for z in heights.values()])
    assert means.min() > 0.0
    assert means.max() < 4.3
    assert np.ptp(means) > 2.0
