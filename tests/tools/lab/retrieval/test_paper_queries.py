"""Queries of global localization: what is hidden is not seen, and the noise is the paper's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply
from tests.helpers.long_street import generate_street
from tools.lab.retrieval.labelled_map import LabelledMap, labelled_map
from tools.lab.retrieval.paper_queries import SCENARIOS, draw_queries, visible

SELF, FEWER, NOISY = SCENARIOS
RING_M = 20.0


@pytest.fixture(scope="module")
def street() -> tuple[LabelledMap, FloatArray]:
    world = generate_street(rng=np.random.default_rng(0))
    return labelled_map(world), world.tour


def ring(count: int = 40, classes: int = 8, height_m: float = 0.0) -> tuple[LabelledMap, FloatArray]:
    """Objects all around a tour of a millimetre, which sees them all at the same range."""
    angles = 2.0 * np.pi * np.arange(count) / count
    positions = np.column_stack([RING_M * np.cos(angles), RING_M * np.sin(angles), np.full(count, height_m)])
    names = tuple(f"class {number}" for number in range(classes))
    return LabelledMap(positions, np.arange(count) % classes, names), np.array([[0.0, 0.0], [0.001, 0.0]])


# What is hidden.


def polar(ranges_m: list[float], bearings_deg: list[float]) -> FloatArray:
    bearings = np.deg2rad(bearings_deg)
    return np.array(ranges_m)[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])


@pytest.mark.parametrize("bearing_deg", [0.0, 37.0, 120.0, -95.0])
def test_what_is_right_behind_another_object_is_hidden(bearing_deg):
    offsets = polar([5.0, 20.0, 8.0, 8.0, 8.0], [bearing_deg, bearing_deg, 90.0, 210.0, 330.0])
    assert visible(offsets).tolist() == [True, False, True, True, True]
    assert visible(offsets[::-1]).tolist() == [True, True, True, False, True]


@pytest.mark.parametrize(
    "offsets",
    [[], [[3.0, 4.0]], [[3.0, 4.0], [6.0, 8.0]], [[0.0, 0.0], [5.0, 1.0], [9.0, 2.0], [1.0, 7.0]]],
    ids=["none", "one", "two", "one at the viewpoint"],
)
def test_where_nothing_can_be_told_everything_is_visible(offsets):
    shown = visible(np.array(offsets).reshape(-1, 2))
    assert shown.shape == (len(offsets),)
    assert shown.all()


# Queries without noise.


@pytest.mark.parametrize("scenario", [SELF, FEWER], ids=lambda scenario: scenario.name)
def test_query_without_noise_is_all_that_is_visible_within_the_radius(street, scenario):
    objects, tour = street
    for query in draw_queries(objects, tour, scenario, count=30, rng=np.random.default_rng(2)):
        offsets = objects.positions[:, :2] - query.T_map_query_gt[:2, 3]
        near = np.flatnonzero(np.hypot(*offsets.T) < scenario.radius_m)
        assert query.objects.tolist() == near[visible(offsets[near])].tolist()
        placed = apply(query.T_map_query_gt, query.positions)
        np.testing.assert_allclose(placed, objects.positions[query.objects], atol=1e-9)
        np.testing.assert_array_equal(query.labels, objects.labels[query.objects])


# The noise.


def truth_in_sensor_frame(objects: LabelledMap, T_map_query: FloatArray, which: FloatArray) -> FloatArray:
    R, t = T_map_query[:3, :3], T_map_query[:3, 3]
    return np.asarray((objects.positions[which] - t) @ R)


def test_one_object_in_ten_is_missed_whatever_its_range(street):
    objects, tour = street
    noisy = draw_queries(objects, tour, NOISY, count=150, rng=np.random.default_rng(6))
    kept_m, missed_m = [], []
    for query in noisy:
        offsets = objects.positions[:, :2] - query.T_map_query_gt[:2, 3]
        near = np.flatnonzero(np.hypot(*offsets.T) < NOISY.radius_m)
        shown = near[visible(offsets[near])]
        is_kept = np.isin(shown, query.objects)
        assert set(query.objects) <= set(shown)
        kept_m += list(np.hypot(*offsets[shown[is_kept]].T))
        missed_m += list(np.hypot(*offsets[shown[~is_kept]].T))
    total = len(kept_m) + len(missed_m)
    assert abs(len(missed_m) - 0.1 * total) < 4.0 * np.sqrt(0.09 * total)
    assert stats.ks_2samp(kept_m, missed_m).pvalue > 1e-3


def test_a_wrong_class_is_any_other_one_and_twice_as_frequent_at_twice_the_range(street):
    objects, tour = street
    classes = len(objects.vocabulary)
    shares, wrong, steps = [], [], []
    for query in draw_queries(objects, tour, NOISY, count=400, rng=np.random.default_rng(7)):
        ranges_m = np.linalg.norm(truth_in_sensor_frame(objects, query.T_map_query_gt, query.objects), axis=1)
        confused = query.labels != objects.labels[query.objects]
        shares.append(ranges_m / ranges_m.max())
        wrong.append(confused)
        steps.append((query.labels - objects.labels[query.objects])[confused] % classes)
        assert query.labels.min() >= 0
        assert query.labels.max() < classes
    share, is_wrong, step = np.concatenate(shares), np.concatenate(wrong), np.concatenate(steps)
    for low, high in ((0.0, 0.6), (0.6, 1.01)):
        inside = (share >= low) & (share < high)
        expected = 0.2 * share[inside]
        deviation = np.sqrt(np.sum(expected * (1.0 - expected)))
        assert abs(is_wrong[inside].sum() - expected.sum()) < 4.0 * deviation
    # A draw that could hit the right class would come out a twenty-fifth short.
    assert set(step) == set(range(1, classes))
    assert stats.chisquare(np.bincount(step, minlength=classes)[1:]).pvalue > 1e-3


def test_displacements_are_uniform_along_each_axis_and_scales_are_uniform_and_common():
    objects, tour = ring(count=60)
    errors, scales = [], []
    for query in draw_queries(objects, tour, NOISY, count=300, rng=np.random.default_rng(10)):
        truth = truth_in_sensor_frame(objects, query.T_map_query_gt, query.objects)
        scale = _scale_of(query.positions, truth)
        scales.append(scale)
        errors.append((query.positions / scale - truth) / RING_M)
    pooled = np.concatenate(errors)
    assert np.mean(scales) == pytest.approx(1.0, abs=0.02)
    assert stats.kstest(scales, "uniform", args=(0.9, 0.2)).pvalue > 1e-3
    assert pooled.min() > -0.02
    assert pooled.max() < 0.12
    for axis in range(3):
        assert pooled[:, axis].mean() == pytest.approx(0.05, abs=0.002)
        assert pooled[:, axis].std() == pytest.approx(0.1 / np.sqrt(12.0), rel=0.05)
    correlations = np.corrcoef(pooled.T)
    assert np.abs(correlations[np.triu_indices(3, 1)]).max() < 0.05


def _scale_of(positions: FloatArray, truth: FloatArray) -> float:
    """The slope of the regression of the positions on the truth, whose mean error is the constant."""
    seen, true = positions[:, :2] - positions[:, :2].mean(axis=0), truth[:, :2] - truth[:, :2].mean(axis=0)
    return float(np.sum(seen * true) / np.sum(true * true))


# What cannot be.


@pytest.mark.parametrize("tour", [[[1.0, 2.0], [1.0, 2.0]], [[1.0, 2.0]]], ids=["standing still", "one point"])
def test_a_tour_without_length_is_refused(tour):
    objects, _ = ring()
    with pytest.raises(SimulationError, match="no length"):
        draw_queries(objects, np.array(tour), SELF, count=3, rng=np.random.default_rng(0))
