"""Outliers of displacements are clipped beyond what all objects of two scans have in common."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.self_calibration.displacement_outliers import LEAST_OBJECTS, without_outliers
from slam.self_calibration.variance_components import estimate_components
from tests.helpers.surveyed_drives import SurveyedDrive

SIGMA_M = 0.05


def scene(rng: np.random.Generator, pairs: int = 200, objects: int = 20) -> tuple[FloatArray, FloatArray, IntArray]:
    """White displacements of objects 3 to 20 m away."""
    count = pairs * objects
    angles = rng.uniform(-np.pi, np.pi, count)
    x = rng.uniform(3.0, 20.0, count)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return SIGMA_M * rng.normal(size=(count, 2)), x, np.repeat(np.arange(pairs), objects)


def test_gaussian_displacements_keep_their_mean_square():
    d, x, pairs = scene(np.random.default_rng(0))
    found = without_outliers(d, x, pairs)
    assert np.mean(found**2) == pytest.approx(np.mean(d**2), rel=0.02)


def test_outliers_lose_theirs():
    rng = np.random.default_rng(1)
    d, x, pairs = scene(rng)
    wrong = rng.random(len(d)) < 0.05
    spoilt = d + np.where(wrong, 10.0 * SIGMA_M, 0.0)[:, None]
    found = without_outliers(spoilt, x, pairs)
    assert np.mean(spoilt**2) > 4.0 * SIGMA_M**2
    assert np.mean(found**2) < 1.6 * SIGMA_M**2
    np.testing.assert_allclose(found[~wrong], d[~wrong], atol=SIGMA_M)


def test_a_large_motion_that_all_objects_share_is_no_outlier():
    """As where the odometry slips in one of many pairs of scans."""
    d, x, pairs = scene(np.random.default_rng(2))
    slipped = pairs == 7
    moved = d + np.where(slipped[:, None], [1.0, -2.0] + 0.1 * np.stack([-x[:, 1], x[:, 0]], axis=1), 0.0)
    found = without_outliers(moved, x, pairs)
    np.testing.assert_allclose(found - moved, without_outliers(d, x, pairs) - d, atol=0.2 * SIGMA_M)


def test_noise_along_the_line_of_sight_may_be_far_larger_than_across():
    d, x, pairs = scene(np.random.default_rng(3))
    sights = x / np.linalg.norm(x, axis=1)[:, None]
    along = 20.0 * np.einsum("ni,ni->n", d, sights)[:, None] * sights
    found = without_outliers(d + along, x, pairs)
    assert np.mean(found**2) == pytest.approx(np.mean((d + along) ** 2), rel=0.1)


def test_few_objects_are_left_as_they_are():
    d, x, pairs = scene(np.random.default_rng(4), objects=LEAST_OBJECTS - 1)
    d[::7] *= 100.0
    np.testing.assert_array_equal(without_outliers(d, x, pairs), d)
    np.testing.assert_array_equal(without_outliers(d[:0], x[:0], pairs[:0]), d[:0])


def test_a_heavy_tail_does_not_count_as_noise_of_the_detector():
    drive = SurveyedDrive(0, {"radial": SIGMA_M, "tangential": SIGMA_M})
    tracks, rng = drive.tracks, np.random.default_rng(5)
    tail = np.where(
        rng.random((len(tracks.track), 1)) < 0.05, 6.0 * SIGMA_M * rng.normal(size=(len(tracks.track), 2)), 0
    )
    spoilt = replace(tracks, points=tracks.points + tail, offsets=tracks.offsets + tail)
    found = estimate_components(spoilt, drive.motion)
    assert found is not None
    assert np.sqrt(found.white(100.0)[0]) < 1.4 * SIGMA_M
