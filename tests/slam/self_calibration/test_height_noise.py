"""The noise of heights: what each object has of its own, and what all in view have in common."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.self_calibration.height_noise import HeightNoise, estimate_height_noise
from slam.self_calibration.object_tracks import ObjectTracks
from tests.helpers.surveyed_drives import SurveyedDrive


def tracks(own_m: float, common_m: float, seed: int) -> ObjectTracks:
    """Each object at a height of its own; white noise of each detection, and of each scan."""
    rng = np.random.default_rng(seed)
    drive = SurveyedDrive(seed, {"radial": 0.05}, scans=400, objects=100).tracks
    objects, scans = rng.normal(0.0, 3.0, drive.track.max() + 1), rng.normal(0.0, common_m, drive.scan.max() + 1)
    noise = rng.normal(0.0, own_m, len(drive.track))
    return replace(drive, heights=objects[drive.track] + scans[drive.scan] + noise)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("own_m", "common_m"), [(0.1, 0.0), (0.1, 0.4), (0.0, 0.2), (0.5, 0.1)])
def test_both_parts_are_found(own_m, common_m, seed):
    found = estimate_height_noise(tracks(own_m, common_m, seed))
    assert np.sqrt(found.own) == pytest.approx(own_m, rel=0.25, abs=0.15 * common_m + 0.02)
    assert np.sqrt(found.common) == pytest.approx(common_m, rel=0.25, abs=0.15 * own_m + 0.02)


def test_a_wrong_match_counts_little():
    clean = tracks(0.1, 0.0, 0)
    spoiled = clean.heights.copy()
    spoiled[::50] += 20.0
    found = estimate_height_noise(replace(clean, heights=spoiled))
    assert np.sqrt(found.own) < 0.3


def test_too_few_objects_tell_nothing():
    few = np.zeros(20, dtype=np.int64)
    none = np.zeros(20)
    alone = ObjectTracks(few, np.arange(20), np.ones((20, 2)), np.ones((20, 2)), few, none, none, none, none)
    assert estimate_height_noise(alone) == HeightNoise()


def test_noise_that_changes_slowly_is_found_over_longer_times():
    drive = tracks(0.02, 0.0, 0)
    slow = 0.4 * np.sin(2.0 * np.pi * drive.scan / 60.0)
    found = estimate_height_noise(replace(drive, heights=drive.heights + slow))
    assert 0.25 < np.sqrt(found.common) < 0.5


def test_objects_have_nothing_in_common_with_themselves():
    scans = np.tile(np.arange(2000), 2)
    track = np.repeat([0, 1], 2000)
    heights = np.random.default_rng(3).normal(0.0, 0.5, 4000)
    places, none = np.ones((4000, 2)), np.zeros(4000)
    found = estimate_height_noise(ObjectTracks(track, scans, places, places, track, none, heights, none, none))
    assert np.sqrt(found.own) == pytest.approx(0.5, rel=0.1)
    assert np.sqrt(found.common) < 0.2
