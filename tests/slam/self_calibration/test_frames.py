"""Which way the sensor looks: found by which scans agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.common.geometry import roll_pitch_yaw_deg
from slam.self_calibration.frames import find_orientation
from slam.self_calibration.object_tracks import SurveyScan
from tests.helpers.surveyed_drives import NOISE, SurveyedDrive

RIGHT, UPSIDE_DOWN, BACKWARDS, LEFT, OPTICAL = (0, 0, 0), (180, 0, 0), (0, 0, 180), (0, 0, 90), (-90, 0, -90)


def turned(scans: list[SurveyScan], R: np.ndarray) -> list[SurveyScan]:
    """The scans of a sensor whose detections ``R`` would put right."""
    return [replace(scan, positions=scan.positions @ R) for scan in scans]


@pytest.mark.parametrize("angles_deg", [RIGHT, UPSIDE_DOWN, BACKWARDS, LEFT, OPTICAL])
def test_quarter_turns_are_found(drive, angles_deg):
    R = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    found = find_orientation(turned(drive.scans, R))
    np.testing.assert_allclose(found, R, atol=1e-9)


def test_a_mirrored_odometry_looks_like_a_sensor_that_hangs_upside_down(drive):
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    scans = [replace(scan, T_odom_body=mirror @ scan.T_odom_body @ mirror) for scan in drive.scans]
    assert roll_pitch_yaw_deg(find_orientation(scans)) == pytest.approx([180.0, 0.0, 0.0])


def test_a_robot_that_only_goes_straight_on_tells_nothing():
    straight = SurveyedDrive(0, NOISE, scans=600, objects=80, turns=False)
    upside_down = turned(straight.scans, np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_array_equal(find_orientation(upside_down), np.eye(3))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("angles_deg", [RIGHT, UPSIDE_DOWN, OPTICAL, (90, 0, 0), (0, 90, 0)])
def test_the_angles_give_the_rotation_back(angles_deg):
    R = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    again = Rotation.from_euler("xyz", roll_pitch_yaw_deg(R), degrees=True).as_matrix()
    np.testing.assert_allclose(again, R, atol=1e-9)


def test_scans_that_never_agree_tell_nothing():
    rng = np.random.default_rng(1)
    drive = SurveyedDrive(0, NOISE, scans=120, objects=40)
    scans = [replace(scan, positions=rng.uniform(-20.0, 20.0, scan.positions.shape)) for scan in drive.scans]
    np.testing.assert_array_equal(find_orientation(scans), np.eye(3))


def narrow(scans: list[SurveyScan], half_rad: float) -> list[SurveyScan]:
    """The scans of a sensor that looks ahead only."""
    found = []
    for scan in scans:
        seen = np.abs(np.arctan2(scan.positions[:, 1], scan.positions[:, 0])) < half_rad
        if seen.any():
            found.append(replace(scan, positions=scan.positions[seen], labels=scan.labels[seen],
                                 variances=scan.variances[seen]))  # fmt: skip
    return found


@pytest.mark.parametrize("angles_deg", [RIGHT, UPSIDE_DOWN, OPTICAL])
def test_objects_that_come_and_go_at_a_turn_hide_no_orientation(angles_deg):
    drive = SurveyedDrive(1, NOISE, scans=1200, objects=80)
    R = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    np.testing.assert_allclose(find_orientation(turned(narrow(drive.scans, 0.3), R)), R, atol=1e-9)


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("angle_deg", [-30.0, 30.0])
def test_a_sensor_that_is_turned_by_less_than_half_a_quarter_is_not_turned_by_one(drive, axis, angle_deg):
    R = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    np.testing.assert_array_equal(find_orientation(turned(drive.scans, R)), np.eye(3))
