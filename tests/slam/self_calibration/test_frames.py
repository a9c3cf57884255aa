"""Which way the sensor looks: found by which scans agree."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.self_calibration.frames import _reached, find_orientation, roll_pitch_yaw_deg, spacing_of
from slam.self_calibration.object_tracks import SurveyScan
from tests.helpers.surveyed_drives import SurveyedDrive

NOISE = {"radial": 0.05, "tangential": 0.05, "translation_by_travel": 0.02}
RIGHT, UPSIDE_DOWN, BACKWARDS, LEFT, OPTICAL = (0, 0, 0), (180, 0, 0), (0, 0, 180), (0, 0, 90), (-90, 0, -90)


@pytest.fixture(scope="module")
def drive() -> SurveyedDrive:
    return SurveyedDrive(0, NOISE, scans=600, objects=80)


def turned(scans: list[SurveyScan], R: np.ndarray) -> list[SurveyScan]:
    """The scans of a sensor whose detections ``R`` would put right."""
    return [replace(scan, positions=scan.positions @ R) for scan in scans]


@pytest.mark.parametrize("angles_deg", [RIGHT, UPSIDE_DOWN, BACKWARDS, LEFT, OPTICAL])
def test_quarter_turns_are_found(drive, angles_deg):
    R = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    found = find_orientation(turned(drive.scans, R), drive.headings)
    np.testing.assert_allclose(found, R, atol=1e-9)


def test_a_mirrored_odometry_looks_like_a_sensor_that_hangs_upside_down(drive):
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    scans = [replace(scan, T_odom_body=mirror @ scan.T_odom_body @ mirror) for scan in drive.scans]
    assert roll_pitch_yaw_deg(find_orientation(scans, -drive.headings)) == pytest.approx([180.0, 0.0, 0.0])


def test_a_robot_that_only_goes_straight_on_tells_nothing():
    straight = SurveyedDrive(0, NOISE, scans=600, objects=80, turns=False)
    upside_down = turned(straight.scans, np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_array_equal(find_orientation(upside_down, straight.headings), np.eye(3))


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
    np.testing.assert_array_equal(find_orientation(scans, drive.headings), np.eye(3))


def test_no_scan_is_paired_with_itself():
    """All objects in one place ask for no way at all between two scans."""
    assert _reached(np.zeros(5), 0.0) == []
    assert _reached(np.arange(4.0), 0.0) == []
    assert _reached(np.arange(4.0), 2.0) == [(0, 2), (1, 3)]


def test_the_spacing_is_the_distance_of_the_nearest_of_its_class(drive):
    scan = drive.scans[0]
    apart = np.linalg.norm(scan.positions[:, None] - scan.positions, axis=2)
    apart[(scan.labels[:, None] != scan.labels) | np.eye(len(apart), dtype=bool)] = np.inf
    assert spacing_of([scan]) == pytest.approx(np.median(apart.min(axis=1)))
    alone = replace(scan, labels=np.arange(len(scan.labels)))
    assert spacing_of([alone]) == pytest.approx(np.median(np.linalg.norm(scan.positions, axis=1)))


def test_the_spacing_of_many_objects_takes_no_memory_of_all_their_pairs():
    positions = np.random.default_rng(0).uniform(-50.0, 50.0, (5000, 3))
    scan = replace(SurveyedDrive(0, NOISE, scans=2, objects=80).scans[0], positions=positions,
                   labels=np.zeros(5000, dtype=np.int64))  # fmt: skip
    tracemalloc.start()
    try:
        spacing_of([scan])
        assert tracemalloc.get_traced_memory()[1] < 60e6
    finally:
        tracemalloc.stop()
