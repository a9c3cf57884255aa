"""Centroids that lie on the near side of objects: by how much is found from views that change, class by class."""

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.self_calibration.corrections import centroid_biases, without_bias
from slam.self_calibration.object_tracks import ObjectTracks
from tests.helpers.surveyed_drives import tracks_of

NOISE_M = 0.05
VIEW_M = 20.0


def passed(bias_m: FloatArray, *, seed: int = 0) -> tuple[ObjectTracks, FloatArray]:
    """Objects beside a straight way, of the classes 0, 1, ... in turn, and where each detection should have been."""
    rng = np.random.default_rng(seed)
    bodies = np.stack([0.5 * np.arange(400), np.zeros(400)], axis=1)
    places = np.stack([np.arange(10.0, 190.0, 3.0), rng.choice([-6.0, 6.0], 60)], axis=1)
    parts = []
    for number, place in enumerate(places):
        scans = np.flatnonzero(np.abs(bodies[:, 0] - place[0]) < VIEW_M)
        offsets = place - bodies[scans]
        rays = offsets / np.linalg.norm(offsets, axis=1)[:, None]
        label = number % len(bias_m)
        points = place - bias_m[label] * rays + rng.normal(0.0, NOISE_M, offsets.shape)
        same = np.ones(len(scans), int)
        parts.append((number * same, scans, offsets, points, label * same, np.tile(place, (len(scans), 1))))
    track, scan, offsets, points, labels, true = (np.concatenate(column) for column in zip(*parts, strict=True))
    return tracks_of(track, scan, offsets, points, labels), true


@pytest.mark.parametrize("seed", range(3))
def test_the_bias_of_each_class_is_found(seed):
    tracks, _ = passed(np.array([0.3, 0.0, 0.1]), seed=seed)
    np.testing.assert_allclose(centroid_biases(tracks), [0.3, 0.0, 0.1], atol=0.02)


def test_what_is_not_significant_is_none():
    tracks, _ = passed(np.array([0.0005, 0.0]))
    np.testing.assert_array_equal(centroid_biases(tracks), [0.0, 0.0])


def test_few_pairs_of_views_tell_nothing():
    tracks, _ = passed(np.array([0.3]))
    np.testing.assert_array_equal(centroid_biases(tracks.of(tracks.track < 1)), [0.0])
    assert len(centroid_biases(tracks.of(tracks.track < 0))) == 0


def test_detections_are_moved_outwards_by_the_bias_of_their_class():
    biases = np.array([0.3, 0.0])
    tracks, true = passed(biases)
    moved = without_bias(tracks, biases)
    assert np.abs(np.mean(moved.points - true, axis=0)).max() < 0.01
    assert np.linalg.norm(moved.points - true, axis=1).max() < 6.0 * NOISE_M
    longer = np.linalg.norm(moved.offsets, axis=1) - np.linalg.norm(tracks.offsets, axis=1)
    np.testing.assert_allclose(longer, biases[tracks.labels])
