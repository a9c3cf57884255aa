"""KeyframeObservations between two keyframes: their sum is the information-weighted mean."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.calibration import DetectionCalibration
from slam.frontend.input.scan import Scan
from slam.frontend.keyframe_observations import MAX_MEASUREMENTS, KeyframeObservations
from tests.logs.examples import random_covariance

CONFIG = DetectionCalibration(common_sigma_m=0.3, covariance_inflation=25.0)


def random_sightings(rng, landmarks: int = 5, scans: int = 8):
    """(rows, positions, covariances) of each scan; every landmark is in some scans."""
    for _ in range(scans):
        rows = np.flatnonzero(rng.random(landmarks) < 0.7) * 10
        yield (
            rows,
            rng.normal(size=(len(rows), 3)),
            np.stack([random_covariance(rng, 3) for _ in rows] or [np.eye(3)])[: len(rows)],
        )


def summed(scans, *, own: bool = True):
    measurements = KeyframeObservations()
    for rows, positions, covariances in scans:
        flags = np.full(len(rows), own)
        scan = Scan(
            0, "lidar", positions, covariances, ("tree",) * len(rows), np.ones(len(rows), dtype=np.bool_), flags
        )
        measurements.add(rows, scan)
    return {observation.landmark: observation for observation in measurements.observations(7, CONFIG)}


def test_the_sum_is_the_information_weighted_mean():
    scans = list(random_sightings(np.random.default_rng(0)))
    found = summed(scans)
    assert sorted(found) == [0, 10, 20, 30, 40]
    for row, observation in found.items():
        seen = [(p[rows == row][0], P[rows == row][0]) for rows, p, P in scans if row in rows]
        assert len(seen) > 1
        weights = [np.linalg.inv(P) for _, P in seen]
        covariance = np.linalg.inv(np.sum(weights, axis=0))
        mean = covariance @ np.sum([W @ p for W, (p, _) in zip(weights, seen, strict=True)], axis=0)
        np.testing.assert_allclose(observation.position, mean, atol=1e-10)
        np.testing.assert_allclose(observation.covariance, covariance, atol=1e-10)
        assert observation.keyframe == 7
        assert observation.covariance_inflation == 1.0


def test_the_order_of_scans_does_not_matter():
    scans = list(random_sightings(np.random.default_rng(1)))
    forwards, backwards = summed(scans), summed(scans[::-1])
    assert sorted(forwards) == sorted(backwards)
    for row, observation in forwards.items():
        np.testing.assert_allclose(observation.position, backwards[row].position, atol=1e-10)
        np.testing.assert_allclose(observation.covariance, backwards[row].covariance, atol=1e-10)


def test_without_covariances_of_its_own_the_error_that_all_share_is_added():
    scans = list(random_sightings(np.random.default_rng(2)))
    own, guessed = summed(scans), summed(scans, own=False)
    for row, observation in guessed.items():
        np.testing.assert_allclose(observation.position, own[row].position, atol=1e-12)
        np.testing.assert_allclose(observation.covariance, own[row].covariance + 0.3**2 * np.eye(3), atol=1e-12)
        assert observation.covariance_inflation == 25.0


def test_no_average_gets_better_than_what_all_sightings_share():
    one = (np.array([0]), np.zeros((1, 3)), 0.5**2 * np.eye(3)[None])
    (observation,) = summed([one] * 10_000, own=False).values()
    assert np.sqrt(observation.covariance[0, 0]) == pytest.approx(np.hypot(0.3, 0.5 / np.sqrt(MAX_MEASUREMENTS)))
    (own,) = summed([one] * 10_000).values()
    assert np.sqrt(own.covariance[0, 0]) == pytest.approx(0.5 / np.sqrt(MAX_MEASUREMENTS), rel=1e-3)


def test_nothing_seen_gives_no_observation():
    assert KeyframeObservations().observations(0, CONFIG) == []
    assert summed([(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))]) == {}


def test_more_landmarks_than_were_reserved():
    rows = np.arange(100)
    found = summed([(rows, rows[:, None] * np.ones(3), np.tile(np.eye(3), (100, 1, 1)))] * 2)
    assert len(found) == 100
    np.testing.assert_allclose(found[99].position, [99.0, 99.0, 99.0])
    np.testing.assert_allclose(found[99].covariance, 0.5 * np.eye(3))
