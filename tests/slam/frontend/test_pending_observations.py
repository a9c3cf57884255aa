"""PendingObservations: what waits, what goes into the graph, and what never does."""

from dataclasses import replace

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.common.config import Config
from slam.frontend.pending_observations import MAX_MEASUREMENTS, PendingObservations
from slam.object_map.landmarks import ObjectMap, RetirementReason
from tests.helpers.landmarks import add_landmarks, scan_of
from tests.helpers.poses import keyframe_at, pose_at
from tests.logs.examples import random_covariance

PRECISE = {"translation_sigma": 1e-4, "yaw_sigma": 1e-5, "min_translation_sigma_m": 1e-4}
NOISY = {"translation_sigma": 1.0, "yaw_sigma": 0.1}


class Drive:
    """Two landmarks that every keyframe observes."""

    def __init__(self, odometry: dict[str, float]) -> None:
        self.map = ObjectMap(ObjectCalibration())
        self.rows = add_landmarks(self.map, np.eye(2, 3), confirmed=False)
        self.pending = PendingObservations(Config.model_validate({"calibration": {"odometry": odometry}}), self.map)

    def close(self, number: int, *, ends_group: bool = False) -> list[tuple[int, int]]:
        """Landmark and keyframe of each observation that goes into the graph."""
        self.pending.add(self.rows, scan_of(5.0 * np.eye(2, 3)))
        last = keyframe_at(pose_at(2.0 * number), number, travel_m=2.0 * number)
        ready = self.pending.close(last, ends_group=ends_group)
        return [(each.landmark, each.keyframe) for each in ready]


@pytest.mark.parametrize(("odometry", "expected"), [(PRECISE, [4, 8]), (NOISY, [1, 2, 3, 4, 5, 6, 7, 8])])
def test_keyframes_are_grouped_by_four_where_the_odometry_is_precise(odometry, expected):
    drive = Drive(odometry)
    drive.map.confirm(drive.rows)
    found = [pair for number in range(1, 9) for pair in drive.close(number)]
    assert sorted(found) == [(row, number) for row in (0, 1) for number in expected]


def test_the_last_group_can_be_ended():
    drive = Drive(PRECISE)
    drive.map.confirm(drive.rows)
    assert drive.close(1) == []
    assert drive.close(2, ends_group=True) == [(0, 2), (1, 2)]


def test_observations_of_tentative_landmarks_wait_until_they_are_confirmed():
    drive = Drive(NOISY)
    assert drive.close(1, ends_group=True) == []
    drive.map.confirm(drive.rows[1:])
    assert drive.close(2, ends_group=True) == [(1, 1), (1, 2)]


def test_observations_of_retired_landmarks_are_dropped():
    drive = Drive(PRECISE)
    drive.map.retire(drive.rows[:1], RetirementReason.NOT_CONFIRMED)
    drive.map.confirm(drive.rows[1:])
    drive.close(1)
    assert drive.close(2, ends_group=True) == [(1, 2)]
    drive.map.confirm(drive.rows)
    assert drive.close(3, ends_group=True) == [(0, 3), (1, 3)]


# The measurements since the last keyframe


def summed(scans, *, own: bool = True):
    """The observations of keyframe 7, of confirmed landmarks, by (rows, positions, covariances) of each scan, to which
    errors of its stamp are added.
    """
    object_map = ObjectMap(ObjectCalibration())
    add_landmarks(object_map, np.zeros((5, 3)))
    detection = {"common_sigma_m": 0.3, "covariance_inflation": 25.0}
    pending = PendingObservations(Config.model_validate({"calibration": {"detection": detection}}), object_map)
    for rows, positions, covariances in scans:
        scan = replace(scan_of(positions, has_own=own), stamp_shifts=np.roll(positions, 1))
        pending.add(rows, replace(scan, covariances=covariances + scan.covariances - scan.own_covariances))
    return {each.landmark: each for each in pending.close(keyframe_at(np.eye(4), 7), ends_group=True)}


@pytest.mark.parametrize("own", [True, False])
def test_measurements_of_a_keyframe_are_averaged_by_their_information(own):
    """Where messages have no covariance, the error that all share is added."""
    rng = np.random.default_rng(0)
    scans = list[tuple[IntArray, FloatArray, FloatArray]]()
    for _ in range(8):
        rows = np.flatnonzero(rng.random(5) < 0.7)
        scans.append((rows, rng.normal(size=(len(rows), 3)), np.array([random_covariance(rng, 3) for _ in rows])))
    found = summed(scans, own=own)
    assert sorted(found) == [0, 1, 2, 3, 4]
    for row, observation in found.items():
        seen = [(p[rows == row][0], P[rows == row][0]) for rows, p, P in scans if row in rows]
        weights = [np.linalg.inv(P) for _, P in seen]
        covariance = np.linalg.inv(np.sum(weights, axis=0))
        mean = covariance @ np.sum([W @ p for W, (p, _) in zip(weights, seen, strict=True)], axis=0)
        np.testing.assert_allclose(observation.position, mean, atol=1e-10)
        shared = 0.0 if own else 0.3**2 * np.eye(3)
        np.testing.assert_allclose(observation.covariance, covariance + shared, atol=1e-10)
        assert observation.keyframe == 7
        assert observation.covariance_inflation == (1.0 if own else 25.0)


def test_robot_that_waits_measures_no_better_than_often():
    one = (np.array([0]), np.zeros((1, 3)), 0.5**2 * np.eye(3)[None])
    (found,) = summed([one] * 1000).values()
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.5 / np.sqrt(MAX_MEASUREMENTS))


def test_keyframe_that_saw_nothing_has_no_observation():
    assert summed([]) == {}
    assert summed([(np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3, 3)))]) == {}
