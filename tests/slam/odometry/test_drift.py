"""How far the odometry may have drifted between two keyframes, and which keyframe was nearest to a place."""

from typing import Any

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration, OdometryCalibration
from slam.common.geometry import transform_from_xyz_yaw
from slam.odometry.drift import KeyframeTrack
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose
from tests.helpers.poses import keyframe_at, pose_at

STEP_M = 2.0
STEP_S = 0.5
KEYFRAMES = 121


def winding_path() -> tuple[FloatArray, FloatArray]:
    """Horizontal positions (K, 2) m and headings (K,) rad along a path that winds to and fro."""
    travel_m = STEP_M * np.arange(KEYFRAMES)
    headings = 0.4 + 2.2 * np.sin(travel_m / 40.0)
    steps = STEP_M * np.column_stack([np.cos(headings[:-1]), np.sin(headings[:-1])])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), headings


def track_of(config: OdometryCalibration, **driven: Any) -> KeyframeTrack:
    track = KeyframeTrack(Calibration(odometry=config))
    for keyframe in keyframes_of(**driven):
        track.add(keyframe)
    return track


def keyframes_of(*, break_at: int = KEYFRAMES, origin: tuple[float, float] = (0.0, 0.0)) -> list[Keyframe]:
    positions, headings = winding_path()
    keyframes = []
    for i in range(KEYFRAMES):
        T_odom_body = transform_from_xyz_yaw(np.array([*(positions[i] + origin), 0.3 * i]), headings[i])
        pose = OdometryPose(round(STEP_S * 1e9) * i, T_odom_body, STEP_M * i, int(i >= break_at), 5.0)
        keyframes.append(Keyframe(i, pose, T_odom_body))
    return keyframes


def odometry_noise(**sigmas: float) -> OdometryCalibration:
    """That noise and no other."""
    silent = {"translation_sigma": 1e-9, "yaw_sigma": 1e-9, "yaw_sigma_by_turn": 0.0}
    least = {"min_translation_sigma_m": 1e-9, "min_rotation_sigma_rad": 1e-9}
    return OdometryCalibration(**(silent | least | sigmas))


def monte_carlo_sigmas(config: OdometryCalibration, first: int, last: int) -> tuple[float, float]:
    """Rms error of the place, each coordinate, and of the heading, where each step adds its share of noise."""
    rng = np.random.default_rng(0)
    positions, headings = winding_path()
    runs, count = 4000, last - first
    turn_rad = np.abs(np.diff(headings[first : last + 1]))
    turn_sigmas = np.sqrt(
        config.yaw_sigma**2 * STEP_M + config.yaw_sigma_by_turn**2 * turn_rad + config.yaw_sigma_by_time**2 * STEP_S
    )
    shift_sigma = np.sqrt(config.translation_sigma**2 * STEP_M + config.translation_sigma_by_time**2 * STEP_S)
    turned = np.cumsum(rng.normal(scale=turn_sigmas, size=(runs, count)), axis=1)
    shifted = rng.normal(scale=shift_sigma, size=(runs, count, 2))
    wrong = headings[first:last] + np.concatenate([np.zeros((runs, 1)), turned[:, :-1]], axis=1)
    moved = STEP_M * np.stack([np.cos(wrong), np.sin(wrong)], axis=2) + shifted
    errors = positions[first] + moved.sum(axis=1) - positions[last]
    return float(np.sqrt(np.mean(errors**2))), float(np.sqrt(np.mean(turned[:, -1] ** 2)))


@pytest.mark.parametrize(("first", "last"), [(0, KEYFRAMES - 1), (20, 70), (65, 100)])
@pytest.mark.parametrize(
    "sigmas",
    [
        {"translation_sigma": 0.1},
        {"translation_sigma_by_time": 0.3},
        {"yaw_sigma": 0.004},
        {"yaw_sigma_by_turn": 0.03},
        {"yaw_sigma_by_time": 0.01},
        {"translation_sigma": 0.08, "yaw_sigma": 0.003, "yaw_sigma_by_turn": 0.02},
    ],
    ids=" ".join,
)
def test_drift_is_as_large_as_random_walks_make_it(first, last, sigmas):
    config = odometry_noise(**sigmas)
    place_m, heading_rad = track_of(config).drift_sigmas(first, last)
    expected_m, expected_rad = monte_carlo_sigmas(config, first, last)
    assert place_m == pytest.approx(expected_m, rel=0.1)
    assert heading_rad == pytest.approx(expected_rad, rel=0.1, abs=1e-6)


def test_drift_does_not_depend_on_where_the_odometry_begins():
    config = OdometryCalibration()
    near, far = track_of(config), track_of(config, origin=(450_000.0, 5_200_000.0))
    for ends in ((10, 110), (60, 75)):
        np.testing.assert_allclose(far.drift_sigmas(*ends), near.drift_sigmas(*ends), rtol=0.01)


def test_drift_across_a_break_is_infinite_and_beside_it_is_not():
    config = OdometryCalibration()
    broken, whole = track_of(config, break_at=60), track_of(config)
    assert broken.drift_sigmas(59, 60) == (np.inf, np.inf)
    assert broken.drift_sigmas(10, 100) == (np.inf, np.inf)
    assert broken.drift_sigmas(10, 59) == whole.drift_sigmas(10, 59)
    assert broken.drift_sigmas(60, 100) == pytest.approx(whole.drift_sigmas(60, 100))


@pytest.mark.parametrize(("from_m", "to_m"), [(300.0, 400.0), (-50.0, -1.0), (50.0, 40.0)])
def test_no_keyframe_is_nearest_where_there_is_none(from_m, to_m):
    assert track_of(OdometryCalibration()).nearest(np.zeros(3), segment=0, from_m=from_m, to_m=to_m) is None
    assert KeyframeTrack(Calibration()).nearest(np.zeros(3), segment=0, from_m=from_m, to_m=to_m) is None


def test_the_nearest_keyframe_is_of_the_segment_that_is_asked_for():
    track = KeyframeTrack(Calibration(odometry=odometry_noise()))
    for number in range(20):  # to and fro; then from the beginning, as another segment
        x_m = 2.0 * (number % 10)
        T = pose_at(x_m, 0.5 * (number // 10))
        track.add(keyframe_at(T, number, travel_m=2.0 * number, segment=number // 10))
    place = np.array([8.0, 0.5, 0.0])
    everywhere = {"from_m": -np.inf, "to_m": np.inf}
    assert track.nearest(place, segment=0, **everywhere) == (4, 0.5)
    assert track.nearest(place, segment=1, **everywhere) == (14, 0.0)
    assert track.nearest(place - [0.0, 0.5, 0.0], segment=1, **everywhere) == (14, 0.5)
    assert track.nearest(place, segment=2, **everywhere) is None
    assert track.nearest(place, segment=0, from_m=9.0, to_m=np.inf)[0] == 5
    assert track.nearest(place, segment=1, from_m=-np.inf, to_m=24.0)[0] == 11


def test_replaced_keyframes_are_a_segment_of_their_own():
    first, between, last = KEYFRAMES // 2, KEYFRAMES // 2 + 5, KEYFRAMES - 1
    track, expected = track_of(OdometryCalibration()), track_of(OdometryCalibration(), break_at=first)
    track.replace_since(keyframes_of(break_at=first)[first:])
    assert track.drift_sigmas(first - 1, last) == (np.inf, np.inf)
    assert track.drift_sigmas(between, last) == pytest.approx(expected.drift_sigmas(between, last))
    place = winding_path()[0][last]
    of = {"from_m": -np.inf, "to_m": np.inf}
    assert [track.nearest(place, segment=1, **of)[0], track.nearest(place, segment=0, **of)[0] < first] == [last, True]


def test_keyframes_of_a_segment_share_cells_of_a_sensor_range():
    track = KeyframeTrack(Calibration())
    for number, (x_m, segment) in enumerate([(1.0, 0), (29.0, 0), (31.0, 0), (1.0, 1)]):
        track.add(keyframe_at(pose_at(x_m, 1.0), number, travel_m=x_m, segment=segment))
    assert track.cells == {(0, 0.0, 0.0), (0, 1.0, 0.0), (1, 0.0, 0.0)}
