from __future__ import annotations

import numpy as np
import pytest

from logs.messages import ObjectDetections
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.registry import parse_faults
from slam.simulation.faults.stream import odometry_of
from tests.slam.simulation.faults.streams import (
    COUNT,
    COVARIANCE,
    OBJECTS,
    T_BODY_SENSOR,
    drive,
    faulty,
    path,
    positions,
    records,
)


def test_unreported_noise_leaves_covariances() -> None:
    changed = faulty("unreported_noise=2")
    noise = positions(changed) - positions(drive())
    assert noise.std() == pytest.approx(2.0, rel=0.1)
    assert noise.mean(axis=(0, 1)) == pytest.approx(np.zeros(3), abs=0.5)
    covariances = [scan.covariances for scan in records(changed, ObjectDetections)]
    assert np.array_equal(covariances, np.tile(COVARIANCE, (COUNT, 4, 1, 1)))


def test_the_claimed_sigma() -> None:
    changed = faulty("claimed_sigma=0.001")
    assert np.array_equal(positions(changed), positions(drive()))
    assert records(changed, ObjectDetections)[0].covariances == pytest.approx(np.tile(1e-6 * np.eye(3), (4, 1, 1)))


def test_all_at_one_point() -> None:
    assert np.array_equal(positions(faulty("one_point=5")), np.tile([5.0, 0.0, 0.0], (COUNT, 4, 1)))


def test_heights_are_those_of_the_body() -> None:
    shift = (positions(faulty("height_offset=2")) - positions(drive())) @ T_BODY_SENSOR[:3, :3].T
    assert shift == pytest.approx(np.tile([0.0, 0.0, 2.0], (COUNT, 4, 1)))


def test_the_sensor_hangs_upside_down() -> None:
    assert positions(faulty("sensor_upside_down")) == pytest.approx(positions(drive()) * [1.0, -1.0, -1.0])


def test_the_sensor_is_turned() -> None:
    # Turned to the left, it sees what is ahead of the body to its right.
    x, y = positions(drive())[..., 0], positions(drive())[..., 1]
    changed = faulty("sensor_yaw=90")
    assert positions(changed)[..., :2] == pytest.approx(np.stack([y, -x], axis=-1))
    assert records(changed, ObjectDetections)[0].covariances[0] == pytest.approx(np.diag([0.04, 0.01, 0.09]))


def test_optical_axes() -> None:
    x, y, z = np.moveaxis(positions(drive()), -1, 0)
    assert positions(faulty("sensor_optical")) == pytest.approx(np.stack([-y, -z, x], axis=-1))


@pytest.mark.parametrize("factor", [0.0, 0.5, 3.0])
def test_errors_against_the_truth_are_multiplied(factor: float) -> None:
    true = np.array([apply(invert(T @ T_BODY_SENSOR), OBJECTS) for T in path()])
    errors = positions(faulty(f"detection_noise={factor}")) - true
    assert errors == pytest.approx(factor * (positions(drive()) - true), abs=1e-9)


@pytest.mark.parametrize("missing", ["/ground_truth", "/ground_truth/detections", "/ground_truth/objects"])
def test_errors_cannot_be_multiplied_without_the_truth(missing: str) -> None:
    without = [entry for entry in drive() if entry.topic != missing]
    with pytest.raises(SimulationError, match=missing):
        apply_faults(without, parse_faults(["detection_noise"]), seed=0)


def test_ranges_are_longer_by_a_factor() -> None:
    assert positions(faulty("ranges_scaled=1.1")) == pytest.approx(1.1 * positions(drive()))


def test_left_and_right_are_exchanged_for_a_while() -> None:
    before, after = positions(drive()), positions(faulty("sensor_mirrored=2"))
    assert after[50:70] == pytest.approx(before[50:70] * [1.0, -1.0, 1.0])
    assert np.array_equal(after[:50], before[:50])
    assert np.array_equal(after[70:], before[70:])


def test_positions_are_in_the_frame_of_the_odometry() -> None:
    changed, T_odom_body = faulty("odometry_frame"), odometry_of(drive())[1]
    expected = [apply(T @ T_BODY_SENSOR, at) for T, at in zip(T_odom_body, positions(drive()), strict=True)]
    assert positions(changed) == pytest.approx(np.array(expected))
    R = (T_odom_body[7] @ T_BODY_SENSOR)[:3, :3]
    assert records(changed, ObjectDetections)[7].covariances[0] == pytest.approx(R @ COVARIANCE @ R.T)
