"""How far labels can be trusted, from objects that are followed by their positions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from slam.common.calibration import ObjectCalibration
from slam.self_calibration.object_tracks import SurveyScan, follow_objects
from slam.self_calibration.survey import _log_likelihood_ratio, estimate_label_noise
from tests.helpers.poses import pose_at

CLASSES = 4
OBJECTS = np.random.default_rng(0).uniform([-10.0, -10.0, 0.0], [60.0, 10.0, 1.0], (60, 3))
LABELS = np.random.default_rng(1).integers(0, CLASSES, 60)
RANGE_M = 15.0


def drive(scans: int = 100, range_m: float = RANGE_M) -> list[SurveyScan]:
    """Scans from a straight drive, 0.5 m apart, with the right labels."""
    made = []
    for number in range(scans):
        T = pose_at(0.5 * number)
        offsets = OBJECTS - T[:3, 3]
        seen = np.hypot(offsets[:, 0], offsets[:, 1]) < range_m
        made.append(SurveyScan(number * 10**8, T, offsets[seen], LABELS[seen], np.full(int(seen.sum()), np.nan)))
    return made


def confused(scans: list[SurveyScan], accuracy: float, seed: int) -> list[SurveyScan]:
    rng = np.random.default_rng(seed)
    return [
        replace(
            scan,
            labels=np.where(rng.random(len(scan.labels)) < accuracy, scan.labels, rng.choice(LABELS, len(scan.labels))),
        )
        for scan in scans
    ]


def renamed(scans: list[SurveyScan], first: int) -> list[SurveyScan]:
    return scans[:first] + [replace(scan, labels=(scan.labels + 1) % CLASSES) for scan in scans[first:]]


def test_right_labels_are_trusted() -> None:
    """Where none of n pairs of sightings differs, one of n + 2 may (Laplace)."""
    tracks = follow_objects(drive(), by_class=False)
    found, pairs = estimate_label_noise(drive()), np.count_nonzero(np.diff(tracks.track) == 0)
    assert found.accuracy == pytest.approx(1.0 - 1.0 / (pairs + 2.0), abs=1e-9)
    ObjectCalibration(label_accuracy=found.accuracy)  # it may be given
    assert not found.is_renamed
    assert not found.is_useless


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("accuracy", [0.6, 0.8, 0.95])
def test_the_accuracy_is_estimated(accuracy: float, seed: int) -> None:
    found = estimate_label_noise(confused(drive(), accuracy, seed))
    assert found.accuracy == pytest.approx(accuracy, abs=0.05)
    assert not found.is_useless


@pytest.mark.filterwarnings("error")
def test_one_class_tells_nothing_of_its_noise() -> None:
    found = estimate_label_noise([replace(scan, labels=np.zeros_like(scan.labels)) for scan in drive()])
    assert np.isnan(found.accuracy)
    assert not found.is_useless


def test_too_few_sightings_tell_nothing() -> None:
    assert np.isnan(estimate_label_noise(drive(3)).accuracy)


@pytest.mark.parametrize("accuracy", [1.0, 0.9])
def test_new_names_of_all_classes_are_found(accuracy: float) -> None:
    found = estimate_label_noise(confused(renamed(drive(), 40), accuracy, 0))
    assert found.is_renamed
    assert found.is_useless


def test_log_likelihood_ratio_is_binomial_by_the_changes_of_all_other_scans() -> None:
    followed, changes = np.array([10, 8, 12]), np.array([10, 0, 3])
    shares = np.array([4.0 / 22.0, 14.0 / 24.0, 11.0 / 20.0])  # by the rule of succession
    expected = [binom.logpmf(changes, followed, each) for each in (1.0 - shares, shares)]
    np.testing.assert_allclose(_log_likelihood_ratio(followed, changes), expected[0] - expected[1])


def test_some_labels_that_change_at_once_are_no_new_names() -> None:
    scans = drive()
    half = np.arange(len(scans[40].labels)) % 2 == 0
    scans[40] = replace(scans[40], labels=np.where(half, (scans[40].labels + 1) % CLASSES, scans[40].labels))
    assert not estimate_label_noise(scans).is_renamed


@pytest.mark.parametrize(("x_m", "yaw_rad"), [(11.0, 3.5), (0.0, 5.5)])
def test_a_jump_of_the_odometry_is_no_new_names(x_m: float, yaw_rad: float) -> None:
    """Other objects then lie where the tracks ended."""
    jump = pose_at(x_m, 3.0, yaw=yaw_rad)
    scans = drive(60, range_m=40.0)
    for number in range(40, len(scans)):
        scans[number] = replace(scans[number], T_odom_body=jump @ scans[number].T_odom_body)
    assert not estimate_label_noise(scans).is_renamed
