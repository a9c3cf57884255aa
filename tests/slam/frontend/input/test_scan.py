"""A message of detections made ready: limits, noise and frames."""

from dataclasses import replace

import numpy as np
import pytest

from logs.messages import ObjectDetections
from slam.common.arrays import FloatArray
from slam.common.calibration import DetectionCalibration
from slam.common.geometry import apply, make_transform, rotation_of
from slam.frontend.input.scan import Scan, in_metres, make_scan, with_expected_noise
from tests.helpers.landmarks import detections_of, spheres
from tests.logs.examples import random_detections, random_transform

HERE, UP = np.eye(4), np.array([0.0, 0.0, 1.0])


def scan_of(
    message: ObjectDetections,
    *,
    T_body_sensor: FloatArray = HERE,
    up_body: FloatArray = UP,
    T_body_before: FloatArray = HERE,
    **settings: float,
) -> Scan:
    return make_scan(message, T_body_sensor, DetectionCalibration(**settings), up_body, T_body_before)


def detections(positions, **given) -> ObjectDetections:
    """Each has a label of its own."""
    labels = [f"object {i}" for i in range(len(positions))]
    return detections_of(positions, labels, stamp_ns=5, **given)


NO_FLOOR = {"sensor_range_m": 1e-6, "max_range_m": 1e3}


def test_what_is_too_far_or_too_doubtful_is_left_out_and_the_limits_themselves_are_in():
    message = detections([[10, 0, 0], [10.001, 0, 0], [1, 0, 0], [2, 0, 0]], scores=[1.0, 1.0, 0.5, 0.499])
    scan = scan_of(message, max_range_m=10.0, min_score=0.5)
    assert scan.used.tolist() == [True, False, True, False]
    assert scan.labels == ("object 0", "object 2")
    np.testing.assert_array_equal(scan.positions, [[10, 0, 0], [1, 0, 0]])
    assert scan.stamp_ns == 5


def test_of_detections_nearer_than_the_resolution_the_one_with_the_highest_score_is_used():
    message = detections([[0, 0, 0], [0.9, 0, 0], [1.8, 0, 0], [5, 0, 0], [5, 0.5, 0]], scores=[0.7, 0.8, 0.6, 1, 1])
    assert scan_of(message, resolution_m=1.0).used.all()  # other labels
    alike = replace(message, labels=("pole",) * 5)
    assert scan_of(alike, resolution_m=1.0).used.tolist() == [False, True, False, True, False]
    assert scan_of(alike).used.all()


def test_a_repeated_detection_hides_no_other():
    """The second is left out for the first, and the third is far enough from that."""
    message = replace(detections([[0, 0, 0], [0.9, 0, 0], [1.8, 0, 0]], scores=[0.8, 0.7, 0.6]), labels=("pole",) * 3)
    used = scan_of(message, resolution_m=1.0, min_score=0.5).used
    assert used.tolist() == [True, False, True]
    used = scan_of(message, resolution_m=1.0, min_score=0.65).used
    assert used.tolist() == [True, False, False]


def test_many_detections_of_one_object_take_little_memory():
    """Their pairs would take 7 GB."""
    message = replace(detections(np.zeros((30_000, 3))), labels=("pole",) * 30_000)
    assert scan_of(message, resolution_m=1.0).used.sum() == 1


def test_a_detection_without_a_place_hides_no_other():
    message = replace(detections([[np.nan, 0, 0], [0, 0, 0]]), labels=("pole",) * 2)
    assert scan_of(message, resolution_m=1.0).used.tolist() == [False, True]


def test_without_covariances_the_noise_grows_with_the_range():
    scan = scan_of(detections([[0, 0, 0], [0, 30, 40]]), base_sigma_m=0.2, sigma_per_m=0.01)
    np.testing.assert_allclose(scan.covariances, [0.2**2 * np.eye(3), 0.7**2 * np.eye(3)])
    assert not scan.has_own_covariance.any()


def test_without_covariances_the_noise_is_larger_along_the_line_of_sight():
    scan = scan_of(
        detections([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]), base_sigma_m=0.5, sigma_per_m=0.0, range_sigma_ratio=4.0
    )
    sight, across = np.array([0.6, 0.8, 0.0]), np.array([0.8, -0.6, 0.0])
    np.testing.assert_allclose(scan.covariances[0] @ sight, 2.0**2 * sight, atol=1e-12)
    np.testing.assert_allclose(scan.covariances[0] @ across, 0.5**2 * across, atol=1e-12)
    np.testing.assert_allclose(scan.covariances[1], 0.5**2 * np.eye(3))


def test_positions_and_covariances_turn_into_the_body_frame():
    rng = np.random.default_rng(0)
    T_body_sensor = random_transform(rng)
    message = random_detections(rng, 6)
    scan = scan_of(message, T_body_sensor=T_body_sensor, **NO_FLOOR)
    assert scan.has_own_covariance.all()
    np.testing.assert_allclose(scan.positions, apply(T_body_sensor, message.positions))
    for turned, own in zip(scan.covariances, message.covariances, strict=True):
        step = np.linalg.cholesky(own)
        ends = apply(make_transform(T_body_sensor[:3, :3], np.zeros(3)), step.T)
        np.testing.assert_allclose(turned, ends.T @ ends, atol=1e-12)


def test_the_range_is_counted_from_the_body_wherever_the_frame_of_the_message_is():
    T_body_odom = make_transform(np.eye(3), np.array([-1000.0, 0, 0]))
    scan = scan_of(detections([[1020, 0, 0], [5, 0, 0]]), T_body_sensor=T_body_odom)
    assert scan.used.tolist() == [True, False]
    np.testing.assert_allclose(scan.covariances, scan_of(detections([[20, 0, 0]])).covariances)


def test_one_unknown_covariance_leaves_the_others_as_they_are():
    own = np.stack([0.3**2 * np.eye(3), np.zeros((3, 3))])
    scan = scan_of(detections([[10, 0, 0], [10, 0, 0]], covariances=own), **NO_FLOOR)
    assert scan.has_own_covariance.tolist() == [True, False]
    np.testing.assert_allclose(scan.covariances, [0.3**2 * np.eye(3), 0.3**2 * np.eye(3)])


@pytest.mark.parametrize("covariances", [None, np.zeros((0, 3, 3))])
def test_an_empty_message_is_an_empty_scan(covariances):
    scan = scan_of(detections([], covariances=covariances))
    assert scan.positions.shape == (0, 3)
    assert scan.covariances.shape == (0, 3, 3)
    assert scan.labels == ()


def test_the_noise_of_heights_is_along_the_vertical_of_a_body_that_leans():
    up_body = np.array([0.0, 0.6, 0.8])
    covariance = scan_of(
        detections([[10, 0, 0]]), up_body=up_body, base_sigma_m=0.1, sigma_per_m=0.0, height_sigma_m=2.0
    ).covariances[0]
    assert up_body @ covariance @ up_body == pytest.approx(0.01 + 4.0)
    across = np.array([0.0, 0.8, -0.6])
    assert across @ covariance @ across == pytest.approx(0.01)


def test_noise_of_the_stamp_is_shared_by_all_detections_of_a_turning_body() -> None:
    turn = rotation_of(np.array([0.0, 0.0, 0.1]))
    message = detections([[10, 0, 0], [0, 10, 0]], covariances=spheres(0.1, 2))
    moved = make_transform(turn, np.array([-1.0, 0.0, 0.0]))
    here, scan = scan_of(message), scan_of(message, T_body_before=moved)
    shifts = message.positions @ turn.T - [1.0, 0.0, 0.0] - message.positions
    np.testing.assert_allclose(scan.stamp_shifts, shifts, atol=1e-12)
    np.testing.assert_allclose(scan.covariances - here.covariances, np.einsum("ni,nj->nij", shifts, shifts), atol=1e-12)
    seen = scan.seen_from(make_transform(turn, np.ones(3))).of(np.array([False, True]))
    np.testing.assert_allclose(seen.stamp_shifts, [turn @ shifts[1]], atol=1e-12)


def test_what_messages_claim_is_scaled_by_how_much_they_understate():
    scan = scan_of(
        detections([[10, 0, 0]], covariances=0.2**2 * np.eye(3)[None]), claimed_sigma_factor=3.0, sensor_range_m=300.0
    )
    np.testing.assert_allclose(scan.covariances[0], (0.6**2 + 0.1**2) * np.eye(3))


def test_the_scale_of_ranges_applies_to_positions_and_their_covariances():
    seen = detections([[4.0, 0.0, 2.0]], covariances=np.eye(3)[None])
    scaled = in_metres(seen, DetectionCalibration(range_scale=0.5))
    np.testing.assert_allclose(scaled.positions, [[2.0, 0.0, 1.0]])
    np.testing.assert_allclose(scaled.covariances, 0.25 * np.eye(3)[None])
    assert in_metres(seen, DetectionCalibration()) is seen


def test_noise_by_the_expected_range_is_the_same_for_short_and_long_measurements() -> None:
    config = {"sigma_per_m": 0.02, "range_sigma_ratio": 3.0, "height_sigma_m": 0.5}
    scan = scan_of(detections([[8, 0, 0], [12, 0, 0], [10, 0, 0]]), **config)
    expected = with_expected_noise(scan, np.full(3, 10.0), DetectionCalibration(**config))
    for covariance in expected.covariances:
        np.testing.assert_allclose(covariance, scan.covariances[2], atol=1e-12)
    np.testing.assert_array_equal(expected.positions, scan.positions)
    own = replace(scan, has_own_covariance=np.ones(3, bool))
    unchanged = with_expected_noise(own, np.ones(3), DetectionCalibration(**config))
    np.testing.assert_allclose(unchanged.covariances, scan.covariances)
