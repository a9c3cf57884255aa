"""Queries of global localization: what is hidden is not seen, and the noise is the paper's."""

import numpy as np
import pytest
from scipy import stats

from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert
from tests.helpers.long_street import start_of_street
from tools.lab.retrieval.labelled_map import LabelledMap
from tools.lab.retrieval.paper_queries import SCENARIOS, draw_queries, visible

SELF, FEWER, NOISY = SCENARIOS
RING_M = 20.0


@pytest.fixture(scope="module")
def street() -> tuple[LabelledMap, FloatArray]:
    return start_of_street(1000.0)


def ring(count: int = 40) -> tuple[LabelledMap, FloatArray]:
    """Objects all around a tour of a millimetre, which sees them all at the same range."""
    angles = 2.0 * np.pi * np.arange(count) / count
    positions = np.column_stack([RING_M * np.cos(angles), RING_M * np.sin(angles), np.zeros(count)])
    names = tuple(f"class {number}" for number in range(8))
    return LabelledMap(positions, np.arange(count) % 8, names), np.array([[0.0, 0.0], [0.001, 0.0]])


# What is hidden.


def polar(ranges_m: list[float], bearings_deg: list[float]) -> FloatArray:
    bearings = np.deg2rad(bearings_deg)
    return np.array(ranges_m)[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])


@pytest.mark.parametrize("bearing_deg", [0.0, -95.0])
def test_what_is_right_behind_another_object_is_hidden(bearing_deg):
    offsets = polar([5.0, 20.0, 8.0, 8.0, 8.0], [bearing_deg, bearing_deg, 90.0, 210.0, 330.0])
    assert visible(offsets).tolist() == [True, False, True, True, True]
    assert visible(offsets[::-1]).tolist() == [True, True, True, False, True]


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


def test_noise_is_that_of_the_paper() -> None:
    """A tenth is missed, labels are wrong in proportion to the range, and places are off by a bias and a scale."""
    objects, tour = ring(count=60)
    missed, wrong, errors, scales = [], [], [], []
    for query in draw_queries(objects, tour, NOISY, count=300, rng=np.random.default_rng(10)):
        missed.append(1.0 - len(query.objects) / len(objects))
        steps = (query.labels - objects.labels[query.objects]) % len(objects.vocabulary)
        wrong.append(np.bincount(steps, minlength=len(objects.vocabulary)) / len(steps))
        truth = apply(invert(query.T_map_query_gt), objects.positions[query.objects])
        scales.append(_scale_of(query.positions, truth))
        errors.append((query.positions / scales[-1] - truth) / RING_M)
    assert np.mean(missed) == pytest.approx(0.1, abs=0.01)
    assert 1.0 - np.mean(wrong, axis=0)[0] == pytest.approx(0.2, abs=0.02)  # all are as far as the farthest
    np.testing.assert_allclose(np.mean(wrong, axis=0)[1:], 0.2 / 7, atol=0.01)
    assert stats.kstest(scales, "uniform", args=(0.9, 0.2)).pvalue > 1e-3
    pooled = np.concatenate(errors)
    np.testing.assert_allclose(pooled.mean(axis=0), 0.05, atol=0.002)
    np.testing.assert_allclose(pooled.std(axis=0), 0.1 / np.sqrt(12.0), rtol=0.05)


def _scale_of(positions: FloatArray, truth: FloatArray) -> float:
    """The slope of the regression of the positions on the truth, whose mean error is the constant."""
    seen, true = positions[:, :2] - positions[:, :2].mean(axis=0), truth[:, :2] - truth[:, :2].mean(axis=0)
    return float(stats.linregress(true.ravel(), seen.ravel()).slope)
