"""Kidnappings that the odometry does not show, and what is none: each rule without a drive."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slam.common.arrays import BoolArray, FloatArray
from slam.common.config import LocalizationConfig
from slam.common.geometry import apply
from slam.localization.continuity_monitor import FALSE_MATCH_PROBABILITY, PRIOR_EXPECTED, ContinuityMonitor, Visibility
from slam.object_map.landmarks import LANDMARK, LandmarkState
from slam.odometry.keyframe import Keyframe
from tests.helpers.poses import keyframe_at, pose_at

RANGE_M = 30.0
STEP_M = 2.0
LEARNING = 80
"""Keyframes in which the monitor learns where landmarks are seen."""


class Street:
    """A straight street with a landmark every five metres on either side, driven in one direction."""

    def __init__(self, config: LocalizationConfig | None = None) -> None:
        self.monitor = ContinuityMonitor(config or LocalizationConfig(), RANGE_M)
        self.segment = 0
        self.x_m = np.arange(-30.0, 600.0, 5.0)
        self.positions, self.first_m, self.last_m = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
        for side_m in (6.0, -7.0):
            self.place(np.column_stack([self.x_m, np.full_like(self.x_m, side_m), np.zeros_like(self.x_m)]))
        self.keyframe = -1

    def place(self, positions: FloatArray) -> None:
        """Add objects (N, 3) m that were not seen yet."""
        self.positions = np.concatenate([self.positions, positions])
        self.first_m = np.append(self.first_m, np.full(len(positions), np.inf))
        self.last_m = np.append(self.last_m, np.full(len(positions), -np.inf))

    def drive(self, count: int, *, blind: bool = False, hidden: FloatArray | None = None) -> float | None:
        """Drive on; ``hidden`` (N,): landmarks that are not seen. Stops where a kidnapping is noticed, and dates it."""
        for _ in range(count):
            self.keyframe += 1
            travel_m = STEP_M * self.keyframe
            ranges = np.hypot(self.positions[:, 0] - travel_m, self.positions[:, 1])
            seen = (ranges < RANGE_M) & ~np.asarray(blind if hidden is None else hidden, bool)
            self.first_m[seen] = np.minimum(self.first_m[seen], travel_m)
            self.last_m[seen] = travel_m
            noticed = self.monitor.update(self._keyframe(travel_m), self._map())
            if noticed is not None:
                return noticed
        return None

    def carry_off(self) -> None:
        """Other objects stand around the robot from now on; those from before stay in the map where they were."""
        seen = self.first_m < np.inf
        elsewhere = self.positions + np.array([2.3, 1.9, 0.0])
        self.positions, self.first_m, self.last_m = self.positions[seen], self.first_m[seen], self.last_m[seen]
        self.place(elsewhere)
        self.gone = int(seen.sum())

    def hide_known(self) -> BoolArray:
        return np.arange(len(self.positions)) < self.gone

    def _keyframe(self, travel_m: float) -> Keyframe:
        return keyframe_at(pose_at(travel_m), self.keyframe, travel_m=travel_m, segment=self.segment)

    def _map(self) -> Any:
        rows = np.zeros(len(self.positions), dtype=LANDMARK)
        rows["state"], rows["segment"], rows["position_local"] = LandmarkState.CONFIRMED, self.segment, self.positions
        rows["first_seen_travel_m"], rows["last_seen_travel_m"] = self.first_m, self.last_m
        return SimpleNamespace(rows=rows, detected_m=self.last_m.max())


@pytest.fixture
def street() -> Street:
    street = Street()
    assert street.drive(LEARNING) is None
    return street


def test_a_kidnapping_is_noticed_within_a_sensor_range_and_dated(street):
    street.carry_off()
    noticed = street.drive(int(RANGE_M / STEP_M), hidden=street.hide_known())
    assert abs(noticed - STEP_M * (LEARNING - 1)) <= STEP_M


def test_a_drive_without_one_raises_no_alarm(street):
    assert Street().monitor.kidnapping_probability == 0.0
    assert street.drive(150) is None


def test_kidnappings_are_sought_within_two_sensor_ranges(street):
    first, *_, last = street.monitor._steps
    assert last.pose.travel_m - first.pose.travel_m == 2.0 * RANGE_M


@pytest.mark.parametrize("count", [10, 20, 25])
def test_a_sensor_that_is_blind_on_the_way_is_no_kidnapping(street, count):
    assert street.drive(count, blind=True) is None
    assert street.drive(15) is None


def test_many_new_objects_are_none(street):
    street.place(street.positions + np.array([1.7, 2.4, 0.0]))
    assert street.drive(30) is None


def test_half_of_the_landmarks_that_vanish_are_none(street):
    assert street.drive(15, hidden=street.positions[:, 1] > 0.0) is None


@pytest.mark.parametrize("breaks", [False, True], ids=["restart", "break of the odometry"])
def test_after_a_new_segment_nothing_from_before_is_expected(street, breaks):
    if breaks:
        street.segment = 1
    else:
        street.monitor.restart()
    street.carry_off()
    assert street.drive(20, hidden=street.hide_known()) is None


def test_after_a_kidnapping_the_next_one_is_as_improbable_as_before(street):
    street.carry_off()
    assert street.drive(int(RANGE_M / STEP_M), hidden=street.hide_known()) is not None
    assert street.monitor.kidnapping_probability > 0.99
    street.monitor.restart()
    street.drive(1, hidden=street.hide_known())
    assert street.monitor.kidnapping_probability < 1e-3


def test_two_landmarks_that_are_missed_are_enough():
    street = Street()
    kept_m = 2.0 * LEARNING * STEP_M - 4.0
    others = np.ones(len(street.positions), bool)
    others[np.flatnonzero(street.x_m >= kept_m)[0]] = False
    others[len(street.x_m) + np.flatnonzero(street.x_m >= kept_m)[0]] = False
    assert street.drive(LEARNING) is None
    assert street.drive(LEARNING, hidden=others) is None
    street.carry_off()
    assert street.drive(5, hidden=street.hide_known()) is not None


def test_what_looks_like_a_kidnapping_is_not_learned_from():
    street = Street(LocalizationConfig(failures_per_km=1e-300))
    assert street.drive(LEARNING) is None
    before = street.monitor._counts.copy()
    street.carry_off()
    street.drive(3, hidden=street.hide_known())
    during = street.monitor._counts.copy()
    assert street.drive(5, hidden=street.hide_known()) is None
    assert (street.monitor._counts == during).all()
    assert (before[:, 0] / before.sum(axis=1) > 0.9).all()


def test_sides_of_a_time_tell_what_was_seen_there_and_whether_known_landmarks_were_in_view_at_all(street):
    """In one of the keyframes before that time, or after it but for the next one, whose sightings may be of before."""
    landmarks, steps = street._map().rows, street.monitor._steps
    first_m, last_m = landmarks["first_seen_travel_m"], landmarks["last_seen_travel_m"]
    at_m, visibility = np.array([step.pose.travel_m for step in steps]), street.monitor._visibility
    missed = np.array([1.0 - visibility.probability(apply(each.T_gravity_local, street.positions)) for each in steps])
    times_m = at_m[[5, 20]]
    in_view, seen = street.monitor._sides(landmarks, times_m)
    for number, time_m in enumerate(times_m):
        before, after = (1.0 - np.prod(missed[side], axis=0) for side in (at_m <= time_m, at_m > time_m + STEP_M))
        known = np.stack([first_m <= time_m, last_m > time_m])
        np.testing.assert_array_equal(seen[:, number], known[::-1])
        np.testing.assert_allclose(in_view[:, number], np.where(known, [after, before], 0.0))


def test_sightings_speak_against_a_kidnapping_and_misses_for_it():
    monitor, by_chance = ContinuityMonitor(LocalizationConfig(), RANGE_M), FALSE_MATCH_PROBABILITY
    monitor._counts[:] = [[9.0, 1.0], [7.0, 3.0]]
    in_view, seen = np.array([[[0.5, 1.0]], [[0.0, 0.8]]]), np.array([[[0.0, 1.0]], [[1.0, 0.0]]])
    missed = (1.0 - 0.5 * by_chance) / (1.0 - 0.5 * 0.9) * (1.0 - 0.8 * by_chance) / (1.0 - 0.8 * 0.7)
    found = monitor._log_likelihood_ratios(in_view, seen)
    np.testing.assert_allclose(found, [np.log(missed * by_chance / 0.9)])


# Where a sensor sees landmarks

AHEAD, BEHIND, FAR = np.array([[5.0, 1.0]]), np.array([[-5.0, 1.0]]), np.array([[31.0, 1.0]])


def test_the_probability_of_a_sighting_is_the_share_of_those_that_were_expected() -> None:
    visibility = Visibility(RANGE_M)
    assert visibility.probability(AHEAD) == 0.0
    visibility.learn(np.repeat(AHEAD, 4, axis=0), np.array([True, True, True, False]))
    assert visibility.probability(AHEAD) == 3.0 / (4.0 + PRIOR_EXPECTED)
    assert visibility.probability(np.array([[8.0, 4.0]])) == visibility.probability(AHEAD)  # in the same cell
    assert visibility.probability(BEHIND) == 0.0


def test_nothing_is_learned_of_what_is_out_of_range() -> None:
    visibility = Visibility(RANGE_M)
    visibility.learn(FAR, np.array([True]))
    assert visibility.probability(FAR) == 0.0
