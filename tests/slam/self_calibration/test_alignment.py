"""What is wrong with the time and the axes of detections, and with the climb of the odometry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.messages import ObjectDetections, Odometry, Record
from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration, DetectionCalibration, OdometryCalibration
from slam.common.geometry import transform_from_xyz_yaw
from slam.odometry.calibrated_odometry import CalibratedOdometry
from slam.self_calibration.alignment import MIN_VALUES, find_alignment
from slam.self_calibration.surveyed_log import SurveyedLog
from tests.helpers.surveyed_drives import INTERVAL_S, SurveyedDrive

NOISE = {"radial": 0.05, "tangential": 0.05, "translation_by_travel": 0.02}


def found(*logs: SurveyedLog, known: Calibration | None = None) -> dict[str, float]:
    return find_alignment(logs, known or Calibration(), list(MIN_VALUES))[0]


def log_of(drive: SurveyedDrive, late_s: float = 0.0, R: FloatArray | None = None, shift_m: float = 0.0) -> SurveyedLog:
    return SurveyedLog.of(records_of(drive, late_s, R, shift_m))


def records_of(drive: SurveyedDrive, late_s: float, R: FloatArray | None, shift_m: float) -> list[Record]:
    """Detections that are of so much later than their stamps say, of a sensor that sits so far ahead of where it is
    said to, in axes that R (3, 3) turns into the body's.
    """
    records: list[Record] = []
    turn = np.eye(3) if R is None else R
    for scan in drive.scans:
        labels = tuple("stem" for _ in scan.labels)
        records.append(Odometry(scan.stamp_ns, scan.T_odom_body, "odom", "base_link"))
        stamp_ns = scan.stamp_ns - round(late_s * 1e9)
        if stamp_ns >= 0:
            records.append(
                ObjectDetections(
                    stamp_ns,
                    "base_link",
                    (scan.positions - [shift_m, 0.0, 0.0]) @ turn,
                    labels,
                    np.ones(len(labels)),
                )
            )
    return records


@pytest.mark.parametrize("late_s", [0.5, -0.5, 5.0 * INTERVAL_S])
def test_the_delay_of_all_detections_is_found(late_s):
    drive = SurveyedDrive(0, NOISE, scans=600, objects=80)
    assert found(log_of(drive, late_s)) == {"delay_s": pytest.approx(late_s, abs=0.02)}


def test_logs_of_one_robot_tell_one_delay():
    logs = [log_of(SurveyedDrive(seed, NOISE, scans=600, objects=80), 0.5) for seed in (0, 1)]
    assert found(*logs) == {"delay_s": pytest.approx(0.5, abs=0.02)}


def test_nothing_is_found_where_nothing_is_wrong():
    assert found(log_of(SurveyedDrive(0, NOISE, scans=600, objects=80))) == {}


def test_a_known_delay_is_not_found_again():
    drive = SurveyedDrive(0, NOISE, scans=600, objects=80)
    known = Calibration(detection=DetectionCalibration(time_offset_s=0.5))
    assert found(log_of(drive, 0.5), known=known) == {}


def test_a_body_that_stands_still_tells_no_delay():
    drive = SurveyedDrive(0, NOISE, scans=200, objects=80)
    log, T = SurveyedLog(), transform_from_xyz_yaw(np.zeros(3), 0.0)
    for scan in drive.scans:
        log.add(Odometry(scan.stamp_ns, T, "odom", "base_link"))
        labels = tuple("stem" for _ in scan.labels)
        log.add(ObjectDetections(scan.stamp_ns, "base_link", drive.scans[0].positions[:1], labels[:1], np.ones(1)))
    assert found(log) == {}


def test_no_log_has_no_delay():
    assert found() == {}
    assert found(SurveyedLog()) == {}


@pytest.mark.parametrize(("axis", "angle"), [("y", 0.26), ("y", -0.12), ("z", 0.2), ("x", 0.2)])
def test_the_angle_of_a_sensor_is_found(axis, angle):
    drive = SurveyedDrive(0, NOISE, scans=600, objects=80)
    term = {"x": "roll_rad", "y": "pitch_rad", "z": "yaw_rad"}[axis]
    R = Rotation.from_euler(axis, angle).as_matrix()
    assert found(log_of(drive, R=R)) == {term: pytest.approx(angle, abs=0.02)}


def test_a_delay_and_an_angle_are_told_apart():
    drive = SurveyedDrive(0, NOISE, scans=600, objects=80)
    values = found(log_of(drive, 0.5, Rotation.from_euler("z", 0.2).as_matrix()))
    assert values == {"delay_s": pytest.approx(0.5, abs=0.02), "yaw_rad": pytest.approx(0.2, abs=0.02)}


@pytest.mark.parametrize("scales", [{"length_scale": 0.7}, {"turn_scale": 0.6}])
def test_nothing_is_found_where_lengths_or_turns_of_the_odometry_explain_more(scales):
    """A shorter turn looks like a delay where a robot turns to and fro."""
    wrong = CalibratedOdometry(OdometryCalibration(**scales))
    records = records_of(SurveyedDrive(0, NOISE, scans=600, objects=80), 0.0, None, 0.0)
    log = SurveyedLog.of(wrong.correct(each) if isinstance(each, Odometry) else each for each in records)
    assert found(log) == {}


@pytest.mark.parametrize("shift_m", [0.0, 2.0])
def test_a_climb_that_the_odometry_lacks_is_found_beside_a_shift_that_explains_more(shift_m):
    falling = CalibratedOdometry(OdometryCalibration(climb=-0.1))
    records = records_of(SurveyedDrive(0, NOISE, scans=600, objects=80), 0.0, None, shift_m)
    log = SurveyedLog.of(falling.correct(each) if isinstance(each, Odometry) else each for each in records)
    assert found(log) == {"climb_share": pytest.approx(0.1, abs=0.01)}


def test_a_sensor_that_sits_elsewhere_has_no_angle():
    drive = SurveyedDrive(0, NOISE, scans=600, objects=80)
    assert found(log_of(drive, shift_m=2.0)) == {}


def test_a_small_angle_is_suspected_only(monkeypatch):
    monkeypatch.setitem(MIN_VALUES, "yaw_rad", 0.3)
    log = log_of(SurveyedDrive(0, NOISE, scans=600, objects=80), R=Rotation.from_euler("z", 0.2).as_matrix())
    values, suspected = find_alignment([log], Calibration(), list(MIN_VALUES))
    assert values == {}
    assert suspected["yaw_rad"] == pytest.approx(0.2, abs=0.02)


def test_a_term_that_is_not_asked_for_is_not_found():
    log = log_of(SurveyedDrive(0, NOISE, scans=600, objects=80), R=Rotation.from_euler("y", 0.26).as_matrix())
    values, _ = find_alignment([log], Calibration(), ["delay_s", "yaw_rad"])
    assert values == {}
