"""A message of detections made ready: limits, noise and frames."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from logs.messages import ObjectDetections
from slam.common.calibration import DetectionCalibration
from slam.common.geometry import apply, make_transform
from slam.frontend.input import scan as scans
from slam.frontend.input.scan import in_metres, with_expected_noise
from tests.logs.examples import random_detections, random_transform

make_scan = partial(scans.make_scan, up_body=np.array([0.0, 0.0, 1.0]))


def detections(positions, *, scores=None, covariances=None) -> ObjectDetections:
    positions = np.array(positions, dtype=float).reshape(-1, 3)
    scores = np.ones(len(positions)) if scores is None else np.array(scores)
    labels = tuple(f"object {i}" for i in range(len(positions)))
    return ObjectDetections(5, "lidar", positions, labels, scores, covariances)


NO_FLOOR = DetectionCalibration(sensor_range_m=1e-6, max_range_m=1e3)


def test_what_is_too_far_or_too_doubtful_is_left_out_and_the_limits_themselves_are_in():
    config = DetectionCalibration(max_range_m=10.0, min_score=0.5)
    message = detections([[10, 0, 0], [10.001, 0, 0], [1, 0, 0], [2, 0, 0]], scores=[1.0, 1.0, 0.5, 0.499])
    scan = make_scan(message, np.eye(4), config)
    assert scan.used.tolist() == [True, False, True, False]
    assert scan.labels == ("object 0", "object 2")
    np.testing.assert_array_equal(scan.positions, [[10, 0, 0], [1, 0, 0]])
    assert scan.stamp_ns == 5


def test_of_detections_nearer_than_the_resolution_the_one_with_the_highest_score_is_used():
    config = DetectionCalibration(resolution_m=1.0)
    message = detections([[0, 0, 0], [0.9, 0, 0], [1.8, 0, 0], [5, 0, 0], [5, 0.5, 0]], scores=[0.7, 0.8, 0.6, 1, 1])
    assert make_scan(message, np.eye(4), config).used.all()  # other labels
    alike = replace(message, labels=("pole",) * 5)
    assert make_scan(alike, np.eye(4), config).used.tolist() == [False, True, False, True, False]
    assert make_scan(alike, np.eye(4), DetectionCalibration()).used.all()


def test_a_repeated_detection_hides_no_other():
    """The second is left out for the first, and the third is far enough from that."""
    message = replace(detections([[0, 0, 0], [0.9, 0, 0], [1.8, 0, 0]], scores=[0.8, 0.7, 0.6]), labels=("pole",) * 3)
    used = make_scan(message, np.eye(4), DetectionCalibration(resolution_m=1.0, min_score=0.5)).used
    assert used.tolist() == [True, False, True]
    used = make_scan(message, np.eye(4), DetectionCalibration(resolution_m=1.0, min_score=0.65)).used
    assert used.tolist() == [True, False, False]


def test_many_detections_of_one_object_take_little_memory():
    """Their pairs would take 7 GB."""
    message = replace(detections(np.zeros((30_000, 3))), labels=("pole",) * 30_000)
    assert make_scan(message, np.eye(4), DetectionCalibration(resolution_m=1.0)).used.sum() == 1


def test_a_detection_without_a_place_hides_no_other():
    message = replace(detections([[np.nan, 0, 0], [0, 0, 0]]), labels=("pole",) * 2)
    assert make_scan(message, np.eye(4), DetectionCalibration(resolution_m=1.0)).used.tolist() == [False, True]


def test_without_covariances_the_noise_grows_with_the_range():
    scan = make_scan(
        detections([[0, 0, 0], [0, 30, 40]]), np.eye(4), DetectionCalibration(base_sigma_m=0.2, sigma_per_m=0.01)
    )
    np.testing.assert_allclose(scan.covariances, [0.2**2 * np.eye(3), 0.7**2 * np.eye(3)])
    assert not scan.has_own_covariance.any()


def test_without_covariances_the_noise_is_larger_along_the_line_of_sight():
    config = DetectionCalibration(base_sigma_m=0.5, sigma_per_m=0.0, range_sigma_ratio=4.0)
    scan = make_scan(detections([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]), np.eye(4), config)
    sight, across = np.array([0.6, 0.8, 0.0]), np.array([0.8, -0.6, 0.0])
    np.testing.assert_allclose(scan.covariances[0] @ sight, 2.0**2 * sight, atol=1e-12)
    np.testing.assert_allclose(scan.covariances[0] @ across, 0.5**2 * across, atol=1e-12)
    np.testing.assert_allclose(scan.covariances[1], 0.5**2 * np.eye(3))


def test_positions_and_covariances_turn_into_the_body_frame():
    rng = np.random.default_rng(0)
    T_body_sensor = random_transform(rng)
    message = random_detections(rng, 6)
    scan = make_scan(message, T_body_sensor, NO_FLOOR)
    assert scan.has_own_covariance.all()
    np.testing.assert_allclose(scan.positions, apply(T_body_sensor, message.positions))
    for turned, own in zip(scan.covariances, message.covariances, strict=True):
        step = np.linalg.cholesky(own)
        ends = apply(make_transform(T_body_sensor[:3, :3], np.zeros(3)), step.T)
        np.testing.assert_allclose(turned, ends.T @ ends, atol=1e-12)


def test_the_range_is_counted_from_the_body_wherever_the_frame_of_the_message_is():
    T_body_odom = make_transform(np.eye(3), np.array([-1000.0, 0, 0]))
    scan = make_scan(detections([[1020, 0, 0], [5, 0, 0]]), T_body_odom, DetectionCalibration())
    assert scan.used.tolist() == [True, False]
    np.testing.assert_allclose(
        scan.covariances, make_scan(detections([[20, 0, 0]]), np.eye(4), DetectionCalibration()).covariances
    )


def test_one_unknown_covariance_leaves_the_others_as_they_are():
    own = np.stack([0.3**2 * np.eye(3), np.zeros((3, 3))])
    scan = make_scan(detections([[10, 0, 0], [10, 0, 0]], covariances=own), np.eye(4), NO_FLOOR)
    assert scan.has_own_covariance.tolist() == [True, False]
    np.testing.assert_allclose(scan.covariances, [0.3**2 * np.eye(3), 0.3**2 * np.eye(3)])


def test_no_detector_is_right_to_less_than_the_floor():
    scan = make_scan(detections([[10, 0, 0]], covariances=1e-18 * np.eye(3)[None]), np.eye(4), DetectionCalibration())
    assert np.sqrt(scan.covariances[0, 0, 0]) == pytest.approx(0.01)


@pytest.mark.parametrize("covariances", [None, np.zeros((0, 3, 3))])
def test_an_empty_message_is_an_empty_scan(covariances):
    scan = make_scan(detections([], covariances=covariances), np.eye(4), DetectionCalibration())
    assert scan.positions.shape == (0, 3)
    assert scan.covariances.shape == (0, 3, 3)
    assert scan.labels == ()


def test_the_noise_of_heights_is_along_the_vertical_of_a_body_that_leans():
    up_body = np.array([0.0, 0.6, 0.8])
    config = DetectionCalibration(base_sigma_m=0.1, sigma_per_m=0.0, height_sigma_m=2.0)
    covariance = make_scan(detections([[10, 0, 0]]), np.eye(4), config, up_body=up_body).covariances[0]
    assert up_body @ covariance @ up_body == pytest.approx(0.01 + 4.0)
    across = np.array([0.0, 0.8, -0.6])
    assert across @ covariance @ across == pytest.approx(0.01)


def test_what_messages_claim_is_scaled_by_how_much_they_understate():
    config = DetectionCalibration(claimed_sigma_factor=3.0, sensor_range_m=300.0)
    scan = make_scan(detections([[10, 0, 0]], covariances=0.2**2 * np.eye(3)[None]), np.eye(4), config)
    np.testing.assert_allclose(scan.covariances[0], (0.6**2 + 0.1**2) * np.eye(3))


def test_the_scale_of_ranges_applies_to_positions_and_their_covariances():
    seen = detections([[4.0, 0.0, 2.0]], covariances=np.eye(3)[None])
    scaled = in_metres(seen, DetectionCalibration(range_scale=0.5))
    np.testing.assert_allclose(scaled.positions, [[2.0, 0.0, 1.0]])
    np.testing.assert_allclose(scaled.covariances, 0.25 * np.eye(3)[None])
    assert in_metres(seen, DetectionCalibration()) is seen


def test_noise_by_the_expected_range_is_the_same_for_short_and_long_measurements() -> None:
    config = DetectionCalibration(sigma_per_m=0.02, range_sigma_ratio=3.0, height_sigma_m=0.5)
    scan = make_scan(detections([[8, 0, 0], [12, 0, 0], [10, 0, 0]]), np.eye(4), config)
    expected = with_expected_noise(scan, np.full(3, 10.0), config)
    for covariance in expected.covariances:
        np.testing.assert_allclose(covariance, scan.covariances[2], atol=1e-12)
    np.testing.assert_array_equal(expected.positions, scan.positions)


def test_noise_that_the_message_gives_does_not_change_with_the_expected_range() -> None:
    own = np.array([0.04 * np.eye(3), np.zeros((3, 3))])
    config = DetectionCalibration(sigma_per_m=0.02)
    scan = make_scan(detections([[10, 0, 0], [10, 0, 0]], covariances=own), np.eye(4), config)
    changed = with_expected_noise(scan, np.full(2, 15.0), config).covariances - scan.covariances
    assert not changed[0].any()
    assert changed[1].any()
