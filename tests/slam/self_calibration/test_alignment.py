"""What is wrong with the time and the axes of detections, and with the climb of the odometry."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.dslam_codec import take_rows
from logs.importers.text_log import read_text_log
from logs.messages import ObjectDetections
from slam.common.calibration import Calibration, DetectionCalibration
from slam.self_calibration.alignment import MIN_VALUES, find_alignment
from slam.self_calibration.survey import _alignment
from slam.self_calibration.surveyed_log import SurveyedLog
from tests.helpers.data import ROBOTS, needs_robots
from tests.helpers.surveyed_drives import INTERVAL_S, NOISE, SurveyedDrive, records_of, with_odometry


def found(*logs: SurveyedLog, known: Calibration | None = None) -> dict[str, float]:
    """With what objects that are followed tell."""
    return _alignment(logs, known or Calibration(), list(MIN_VALUES))[0]


def log_of(
    drive: SurveyedDrive,
    late_s: float = 0.0,
    *,
    turned: tuple[str, float] = ("z", 0.0),
    shift_m: float = 0.0,
    **odometry: float,
) -> SurveyedLog:
    """Detections that are of so much later than their stamps say, of a sensor that sits so far ahead of where it is
    said to, and is turned about an axis.
    """
    R = Rotation.from_euler(*turned).as_matrix()
    scans = [replace(scan, positions=(scan.positions - [shift_m, 0.0, 0.0]) @ R) for scan in drive.scans]
    records = [
        replace(each, stamp_ns=each.stamp_ns - round(late_s * 1e9)) if isinstance(each, ObjectDetections) else each
        for each in records_of(scans)
    ]
    return SurveyedLog(with_odometry([each for each in records if each.stamp_ns >= 0], **odometry))


@pytest.mark.parametrize("late_s", [0.5, -0.5, 5.0 * INTERVAL_S])
def test_the_delay_of_all_detections_is_found(drive, late_s):
    assert found(log_of(drive, late_s)) == {"delay_s": pytest.approx(late_s, abs=0.003)}


def test_logs_of_one_robot_tell_one_delay(drive):
    logs = [log_of(each, 0.5) for each in (drive, SurveyedDrive(1, NOISE, scans=600, objects=80))]
    assert found(*logs) == {"delay_s": pytest.approx(0.5, abs=0.02)}


def test_nothing_is_found_where_nothing_is_wrong(drive):
    assert found(log_of(drive)) == {}


def test_a_known_delay_is_not_found_again(drive):
    known = Calibration(detection=DetectionCalibration(time_offset_s=0.5))
    assert found(log_of(drive, 0.5), known=known) == {}


def test_a_body_that_stands_still_tells_no_delay(drive):
    first = drive.scans[0]
    standing = [replace(first, stamp_ns=scan.stamp_ns, T_odom_body=np.eye(4)) for scan in drive.scans[:200]]
    assert found(SurveyedLog(records_of(standing))) == {}


def test_no_log_has_no_delay():
    assert found() == {}
    assert found(SurveyedLog([])) == {}


@pytest.mark.parametrize(("axis", "angle"), [("y", 0.26), ("y", -0.12), ("z", 0.2), ("x", 0.2)])
def test_the_angle_of_a_sensor_is_found(drive, axis, angle):
    term = {"x": "roll_rad", "y": "pitch_rad", "z": "yaw_rad"}[axis]
    assert found(log_of(drive, turned=(axis, angle))) == {term: pytest.approx(angle, abs=0.003)}


def test_a_delay_and_an_angle_are_told_apart(drive):
    values = found(log_of(drive, 0.5, turned=("z", 0.2)))
    assert values == {"delay_s": pytest.approx(0.5, abs=0.02), "yaw_rad": pytest.approx(0.2, abs=0.02)}


def test_a_drift_of_the_heading_is_found() -> None:
    winding = SurveyedDrive(0, NOISE, scans=150, objects=80)
    drift = pytest.approx(np.deg2rad(3.0), abs=2e-3)
    assert found(log_of(winding, drift_deg_per_s=-3.0)) == {"drift_rad_per_s": drift}


@pytest.mark.slow
@needs_robots
@pytest.mark.parametrize(
    ("drive", "near", "odometry", "right"),
    [
        ("cones", 1.0, {}, {}),
        pytest.param("cones", 0.92, {}, {}, marks=pytest.mark.xfail),  # looks like a drift of 2.5 deg/s
        ("victoria_park", 1.0, {}, {"curvature_rad_per_m": np.deg2rad(0.115)}),
        ("mrclam6/robot2", 1.0, {"climb": -0.05}, {"climb_share": 0.05}),
        ("mrclam3/robotA", 1.0, {"drift_deg_per_s": 1.0}, {"drift_rad_per_s": np.deg2rad(-1.0)}),
    ],
)
def test_a_turn_that_the_odometry_lacks_is_no_yaw_and_a_small_climb_no_pitch(drive, near, odometry, right) -> None:
    """Of a car that drives ahead, also where it sees objects on its left too near, of one whose GNSS shows the turn,
    too, of a robot with a narrow view, and of one that sees few objects.
    """
    log = read_text_log(detections=ROBOTS / drive / "detections.csv.gz", odometry=ROBOTS / drive / "odometry.tum.gz")
    records = [*with_odometry(log.records(), **odometry)]
    for each in records:
        if isinstance(each, ObjectDetections):
            each.positions[each.positions[:, 1] > 0.0] *= near
    assert found(SurveyedLog(records)) == pytest.approx(right, abs=5e-3)


@pytest.mark.slow
@needs_robots
def test_a_yaw_is_no_drift_where_only_near_objects_are_seen():
    """Pairs of scans of a car that drives ahead tell no difference, followed objects do; the road's yaw is small."""
    drive = ROBOTS / "cones"
    log = read_text_log(detections=drive / "detections.csv.gz", odometry=drive / "odometry.tum.gz")
    records = [
        take_rows(each, N=np.flatnonzero(np.linalg.norm(each.positions, axis=1) < 9.7))
        if isinstance(each, ObjectDetections)
        else each
        for each in log.records()
    ]
    assert find_alignment([SurveyedLog(records)], Calibration(), list(MIN_VALUES))[0].keys() == {"drift_rad_per_s"}
    assert found(SurveyedLog(records)) == {}


@pytest.mark.parametrize("scales", [{"length_scale": 0.7}, {"turn_scale": 0.6}])
def test_nothing_is_found_where_lengths_or_turns_of_the_odometry_explain_more(drive, scales):
    """A shorter turn looks like a delay where a robot turns to and fro."""
    assert found(log_of(drive, **scales)) == {}


@pytest.mark.parametrize("shift_m", [0.0, 2.0])
def test_a_climb_that_the_odometry_lacks_is_found_beside_a_shift_that_explains_more(drive, shift_m):
    climb = {"climb_share": pytest.approx(0.1, abs=0.01)}
    assert found(log_of(drive, shift_m=shift_m, climb=-0.1)) == climb


def test_a_pitch_of_a_narrow_view_is_no_climb_where_lengths_are_wrong_too(drive, monkeypatch):
    ahead = [np.abs(scan.positions[:, 1]) < 0.46 * scan.positions[:, 0] for scan in drive.scans]
    scans = [
        replace(scan, positions=scan.positions[is_ahead], labels=scan.labels[is_ahead])
        for scan, is_ahead in zip(drive.scans, ahead, strict=True)
    ]
    monkeypatch.setattr(drive, "scans", scans)
    values = found(log_of(drive, turned=("y", 0.26), length_scale=0.93))
    assert values == {"pitch_rad": pytest.approx(0.26, abs=0.02)}


def test_a_small_angle_is_suspected_only(drive, monkeypatch):
    monkeypatch.setitem(MIN_VALUES, "yaw_rad", 0.3)
    values, suspected = find_alignment([log_of(drive, turned=("z", 0.2))], Calibration(), list(MIN_VALUES))
    assert values == {}
    assert suspected["yaw_rad"] == pytest.approx(0.2, abs=0.02)
