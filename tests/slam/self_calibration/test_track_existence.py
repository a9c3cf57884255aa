"""Tracks of objects told from those of false detections."""

from dataclasses import replace

import numpy as np

from slam.self_calibration.object_tracks import SurveyScan, existence_probabilities, follow_objects, objects_among
from slam.self_calibration.variance_components import estimate_components
from tests.helpers.surveyed_drives import SurveyedDrive


def among_false(scans: list[SurveyScan], range_m: float, each: float) -> list[SurveyScan]:
    """The scans with so many false detections a scan, evenly over the view."""
    rng = np.random.default_rng(0)
    spoilt = []
    for scan in scans:
        count = rng.poisson(each)
        r, angle = range_m * np.sqrt(rng.random(count)), rng.uniform(-np.pi, np.pi, count)
        false = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.zeros(count)])
        number = len(scan.positions) + count
        positions, labels = np.concatenate([scan.positions, false]), np.zeros(number, int)
        spoilt.append(replace(scan, positions=positions, labels=labels, variances=np.full(number, np.nan)))
    return spoilt


def test_tracks_of_objects_are_told_from_those_by_chance():
    rng = np.random.default_rng(0)
    is_object = np.arange(20_000) < 400
    links = rng.geometric(np.where(is_object, 0.05, 0.75)) - 1.0
    closeness = rng.gamma(np.maximum(links, 1e-9), np.where(is_object, 5.0, 1.0))
    found = existence_probabilities(links, closeness) > 0.5
    long = links >= 3
    assert np.mean(found[is_object & long]) > 0.97
    assert np.mean(found[~is_object]) < 0.001


def test_without_false_detections_hardly_a_pair_of_sightings_is_lost():
    drive = SurveyedDrive(1, {"radial": 0.1, "tangential": 0.1}, scans=200, objects=60)
    tracks = follow_objects(drive.scans)
    pairs = [int(np.sum(np.diff(each.track) == 0)) for each in (objects_among(tracks), tracks)]
    assert pairs[0] > 0.97 * pairs[1]


def test_two_false_detections_to_each_right_one_hardly_change_the_noise():
    drive = SurveyedDrive(3, {"radial": 0.05, "tangential": 0.05}, scans=200, objects=120)
    per_scan = np.mean([len(scan.positions) for scan in drive.scans])
    scans = among_false(drive.scans, drive.range_m, 2.0 * per_scan)
    tracks = follow_objects(scans)
    sigmas = []
    for each in (tracks, objects_among(tracks)):
        estimate = estimate_components(each, drive.motion)
        sigmas.append(np.sqrt(estimate.white(100.0)))
    assert sigmas[0] > 3.0 * 0.05  # of all tracks
    assert 0.05 / 1.5 < sigmas[1] < 0.05 * 1.5
