"""The test of whether the expected landmarks are observed: each rule without a drive."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.geometry import transform_from_xyz_yaw
from slam.loop_closure.divergence_monitor import LocalizationMonitor
from tests.slam.loop_closure.doubles import SENSOR_RANGE_M, make_submap

AHEAD = np.array([[x, y, 0.0] for x in (6.0, 9.0, 12.0, 15.0) for y in (-4.0, 4.0)])
NONE = np.zeros((0, 3))
HERE = np.eye(4)


@pytest.fixture
def monitor() -> LocalizationMonitor:
    return LocalizationMonitor(SENSOR_RANGE_M)


def watch(
    monitor: LocalizationMonitor,
    seen: FloatArray,
    known: FloatArray = AHEAD,
    *,
    keyframes: int = 6,
    labels: list[int] | None = None,
    first_row: int = 100,
    from_keyframe: int = 10,
) -> int | None:
    """The first keyframe at which the robot is found to be lost; None if it is not."""
    for keyframe in range(from_keyframe, from_keyframe + keyframes):
        if monitor.update(keyframe, make_submap(seen, labels, first_row=first_row), make_submap(known), HERE):
            return keyframe
    return None


def test_who_misses_what_is_expected_and_sees_other_things_is_lost(monitor):
    assert watch(monitor, AHEAD * [1.0, 0.0, 1.0] + [0.0, 0.4, 0.0]) == 13
    assert monitor.is_inconsistent
    assert monitor.inconsistent_since == 9


def test_who_sees_what_is_expected_is_not_lost(monitor):
    assert watch(monitor, AHEAD, keyframes=30) is None
    assert not monitor.is_inconsistent


def test_who_sees_nothing_new_may_be_blind(monitor):
    assert watch(monitor, NONE, keyframes=30) is None


def test_objects_of_another_class_are_others(monitor):
    assert watch(monitor, AHEAD, labels=[1] * len(AHEAD)) == 13


def test_it_takes_three_looks_and_several_landmarks(monitor):
    assert watch(monitor, AHEAD, labels=[1] * len(AHEAD), keyframes=2) is None
    monitor.restart()
    assert watch(monitor, AHEAD, AHEAD[:5], labels=[1] * len(AHEAD)) is None
    monitor.restart()
    assert watch(monitor, AHEAD, AHEAD[:6], labels=[1] * len(AHEAD)) is not None


def test_a_long_time_of_agreement_does_not_outweigh_what_is_missed_now(monitor):
    rows = np.tile(AHEAD, (5, 1))
    for keyframe in range(4):
        monitor.update(keyframe, make_submap(AHEAD), make_submap(rows), HERE)
    known = make_submap(AHEAD, first_row=1000)
    others = make_submap(AHEAD, [1] * len(AHEAD), first_row=2000)
    assert [monitor.update(10 + i, others, known, HERE) for i in range(4)] == [False, False, False, True]


@pytest.mark.parametrize("known", [AHEAD * [-1.0, 1.0, 1.0], AHEAD + np.array([10.0, 0.0, 0.0]), AHEAD * 0.1])
def test_nothing_is_expected_behind_the_robot_far_away_or_on_top_of_it(monitor, known):
    assert watch(monitor, AHEAD, known, labels=[1] * len(AHEAD), keyframes=30) is None


def test_landmarks_are_expected_where_the_pose_puts_them(monitor):
    T = transform_from_xyz_yaw(np.array([100.0, 50.0, 0.0]), 1.0)
    known = make_submap(AHEAD @ T[:3, :3].T + T[:3, 3])
    for keyframe in range(6):
        assert not monitor.update(keyframe, make_submap(AHEAD, first_row=100), known, T)
    assert not monitor.is_inconsistent


def test_a_landmark_is_gone_once_it_was_expected_at_six_confirmed_keyframes_and_never_seen(monitor):
    known, seen = make_submap(AHEAD), make_submap(AHEAD[2:], first_row=100)
    for keyframe in range(6):
        assert monitor.missing().tolist() == []
        monitor.update(keyframe, seen, known, HERE)
        monitor.confirm()
    assert monitor.missing().tolist() == [0, 1]
    monitor.update(7, make_submap(AHEAD), known, HERE)
    assert monitor.missing().tolist() == []


def test_without_a_confirmed_pose_nothing_is_gone(monitor):
    for keyframe in range(20):
        monitor.update(keyframe, make_submap(AHEAD[2:], first_row=100), make_submap(AHEAD), HERE)
    assert monitor.missing().tolist() == []
