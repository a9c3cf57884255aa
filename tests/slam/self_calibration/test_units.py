"""The unit of the odometry's lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.self_calibration.frames import find_unit, is_unit_right
from slam.self_calibration.object_tracks import SurveyScan
from tests.helpers.surveyed_drives import SurveyedDrive


@pytest.fixture(scope="module")
def scans(drive: SurveyedDrive) -> list[SurveyScan]:
    return drive.scans


def scaled(scans: list[SurveyScan], factor: float) -> list[SurveyScan]:
    """With lengths of the odometry multiplied by a factor."""
    T = [scan.T_odom_body * np.array([1.0, 1.0, 1.0, factor]) for scan in scans]
    return [replace(scan, T_odom_body=np.vstack([each[:3], [0, 0, 0, 1]])) for scan, each in zip(scans, T, strict=True)]


@pytest.mark.parametrize("factor", [1e3, 1e-2, 1e5])
def test_the_octave_of_another_unit_is_found(scans, factor):
    assert not is_unit_right(scaled(scans, factor))
    assert 0.6 < find_unit(scaled(scans, factor)) * factor < 1.7


@pytest.mark.parametrize("factor", [1.0, 0.6, 1.7])
def test_lengths_that_are_wrong_by_a_part_are_of_the_same_unit(scans, factor):
    assert is_unit_right(scaled(scans, factor))


def test_a_sensor_that_is_turned_tells_no_unit(scans):
    R = Rotation.from_euler("xyz", [-90.0, 0.0, -90.0], degrees=True).as_matrix()
    assert find_unit([replace(scan, positions=scan.positions @ R) for scan in scans]) == 1.0


def test_few_pairs_of_scans_tell_no_unit(scans):
    assert find_unit(scaled(scans[:30], 1e3)) == 1.0


def test_without_shared_objects_there_is_no_unit(scans):
    rng = np.random.default_rng(0)
    assert find_unit([replace(e, positions=rng.uniform(-15.0, 15.0, e.positions.shape)) for e in scans]) == 1.0
    assert find_unit([]) == find_unit(scans[:1]) == 1.0
    assert not is_unit_right(scans[:1])
