"""Which way the sensor looks, in which frame detections are, and in which unit lengths: by which scans agree."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration, DetectionCalibration
from slam.common.geometry import apply, invert, make_transform, roll_pitch_yaw_deg
from slam.self_calibration.frames import better_frame, find_level, find_orientation, find_unit, is_unit_right
from slam.self_calibration.object_tracks import SurveyScan
from slam.self_calibration.scan_pairs import spacing_of
from slam.self_calibration.survey import Survey, survey
from slam.self_calibration.surveyed_log import SurveyedLog
from tests.helpers.surveyed_drives import NOISE, SurveyedDrive, records_of

RIGHT, UPSIDE_DOWN, BACKWARDS, LEFT, OPTICAL = (0, 0, 0), (180, 0, 0), (0, 0, 180), (0, 0, 90), (-90, 0, -90)


def rotation(angles_deg: ArrayLike) -> FloatArray:
    return np.asarray(Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix())


def turned(scans: list[SurveyScan], R: FloatArray) -> list[SurveyScan]:
    """The scans of a sensor whose detections ``R`` would put right."""
    return [replace(scan, positions=scan.positions @ R) for scan in scans]


def rotations_of(frame_deg: ArrayLike, *, turn_deg: float = 300.0, lean_deg: float = 0.0) -> FloatArray:
    """A body that turns about the vertical and leans at random, in a frame that ``frame_deg`` would make level."""
    leans = np.random.default_rng(0).normal(0.0, lean_deg, (2, 200)) if lean_deg else np.zeros((2, 200))
    bodies = rotation(np.column_stack([*leans, np.linspace(0.0, turn_deg, 200)]))
    return rotation(frame_deg).T @ bodies @ rotation((5.0, 20.0, 0.0))


@pytest.mark.parametrize("frame_deg", [RIGHT, (10.0, -30.0, 0.0), (-90.0, 0.0, 0.0), (3.0, 80.0, 0.0)])
def test_find_level(frame_deg):
    np.testing.assert_allclose(find_level(rotations_of(frame_deg)), rotation(frame_deg), atol=1e-6)
    vertical = find_level(rotations_of(frame_deg, lean_deg=1.0))[2]
    assert vertical @ rotation(frame_deg)[2] > np.cos(np.deg2rad(0.2))


@pytest.mark.parametrize(
    "unknown", [{"turn_deg": 0.0}, {"turn_deg": 3.0, "lean_deg": 1.0}, {"lean_deg": 12.0}, {"lean_deg": 120.0}]
)
def test_find_level_without_evidence(unknown):
    np.testing.assert_array_equal(find_level(rotations_of((10.0, 0.0, 0.0), **unknown)), np.eye(3))


@pytest.mark.parametrize("angles_deg", [RIGHT, UPSIDE_DOWN, BACKWARDS, LEFT, OPTICAL])
@pytest.mark.parametrize("roll_deg", [0.0, 60.0])
def test_quarter_turns_are_found_also_where_the_body_leans(drive, angles_deg, roll_deg):
    R, lean = rotation(angles_deg), rotation((roll_deg, 0.0, 0.0))
    T_upright_body = make_transform(lean, np.zeros(3))
    scans = turned(drive.scans, lean @ R @ lean.T)
    leaning = [replace(scan, T_odom_body=scan.T_odom_body @ T_upright_body) for scan in scans]
    np.testing.assert_allclose(find_orientation(leaning), R, atol=1e-9)


def test_a_robot_that_only_goes_straight_on_tells_nothing():
    straight = SurveyedDrive(0, NOISE, scans=600, objects=80, turns=False)
    upside_down = turned(straight.scans, np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_array_equal(find_orientation(upside_down), np.eye(3))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("angles_deg", [RIGHT, UPSIDE_DOWN, OPTICAL, (90, 0, 0), (0, 90, 0)])
def test_the_angles_give_the_rotation_back(angles_deg):
    R = rotation(angles_deg)
    again = rotation(roll_pitch_yaw_deg(R))
    np.testing.assert_allclose(again, R, atol=1e-9)


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
    R = rotation(angles_deg)
    np.testing.assert_allclose(find_orientation(turned(narrow(drive.scans, 0.3), R)), R, atol=1e-9)


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("angle_deg", [-30.0, 30.0])
def test_a_sensor_that_is_turned_by_less_than_half_a_quarter_is_not_turned_by_one(drive, axis, angle_deg):
    R = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    np.testing.assert_array_equal(find_orientation(turned(drive.scans, R)), np.eye(3))


# The frame of detections


@pytest.fixture(scope="module")
def shorter() -> SurveyedDrive:
    return SurveyedDrive(0, NOISE, scans=400, objects=60)


def fixed(scans: list[SurveyScan]) -> list[SurveyScan]:
    """The scans with positions in the frame of the odometry."""
    return [replace(scan, positions=apply(scan.T_odom_body, scan.positions)) for scan in scans]


def surveyed(scans: list[SurveyScan], frame: str, detection: DetectionCalibration | None = None) -> Survey:
    given = Calibration(detection=detection or DetectionCalibration())
    found = survey([SurveyedLog(records_of(scans, frame))], given)
    assert found is not None
    return found


@pytest.mark.slow
@pytest.mark.parametrize("is_fixed", [False, True])
@pytest.mark.parametrize("frame", ["odom", "base_link"])
def test_the_frame_in_which_objects_stand_still_is_found_whatever_messages_say(shorter, is_fixed, frame):
    scans = fixed(shorter.scans) if is_fixed else shorter.scans
    found = surveyed(scans, frame)
    right = "odom" if is_fixed else "base_link"
    setting = "assume_odometry_frame" if is_fixed else "assume_body_frame"
    assert found.corrected == ({} if frame == right else {f"detection.{setting}": True})
    assert found.max_range_m < 1.1 * shorter.range_m


def test_a_frame_that_was_set_by_hand_is_kept(shorter):
    by_hand = DetectionCalibration(assume_body_frame=True)
    found = surveyed(fixed(shorter.scans), "base_link", by_hand)
    assert "detection.assume_odometry_frame" not in found.corrected
    assert found.max_range_m > 1.1 * shorter.range_m  # in the right frame it is less


def test_objects_that_go_along_with_the_body_roughly_are_in_no_other_frame(shorter):
    """As objects of a narrow view, of which another one is always ahead."""
    rng, spacing_m = np.random.default_rng(0), spacing_of(shorter.scans)
    ahead = [replace(scan, positions=shorter.scans[0].positions + rng.normal(scale=[[s, s, 0.0]], size=(1, 3)),
                     labels=shorter.scans[0].labels) for scan in shorter.scans for s in [0.2 * spacing_m]]  # fmt: skip
    fixed_ahead = [replace(scan, positions=apply(invert(scan.T_odom_body), scan.positions)) for scan in ahead]
    assert better_frame(ahead, {"fixed": fixed_ahead}) is None
    assert better_frame(fixed(shorter.scans), {"fixed": shorter.scans}) == "fixed"


def test_objects_that_the_body_leaves_behind_are_in_no_frame_of_the_odometry(shorter):
    """As those of a coarse detector, which has them where they were until the body has gone on by its grid."""
    ahead = [replace(scan, positions=shorter.scans[0].positions, labels=shorter.scans[0].labels)
             for scan in shorter.scans]  # fmt: skip
    fixed_ahead = [replace(scan, positions=apply(invert(scan.T_odom_body), scan.positions)) for scan in ahead]
    assert better_frame(ahead, {"odometry": fixed_ahead}) is None


def test_without_scans_no_frame_is_found():
    assert better_frame([], {"fixed": []}) is None


# The unit of the odometry's lengths


@pytest.fixture
def scans(drive: SurveyedDrive) -> list[SurveyScan]:
    return drive.scans


def scaled(scans: list[SurveyScan], factor: float) -> list[SurveyScan]:
    """With lengths of the odometry multiplied by a factor."""
    T = [scan.T_odom_body * np.array([1.0, 1.0, 1.0, factor]) for scan in scans]
    return [replace(scan, T_odom_body=np.vstack([each[:3], [0, 0, 0, 1]])) for scan, each in zip(scans, T, strict=True)]


@pytest.mark.parametrize("factor", [1e3, 1e-2, 1e5, 3.28, 0.3])
def test_the_octave_of_another_unit_is_found(scans, factor):
    assert not is_unit_right(scaled(scans, factor))
    assert 0.6 < find_unit(scaled(scans, factor)) * factor < 1.7


@pytest.mark.parametrize("factor", [1.0, 0.8, 1.25])
def test_lengths_that_are_wrong_by_a_part_are_of_the_same_unit(scans, factor):
    assert is_unit_right(scaled(scans, factor))


@pytest.mark.parametrize("seed", [0, 1])
def test_scans_that_share_objects_over_a_short_way_only_tell_no_unit(seed):
    """Lengths that are twice too long choose scans of half the way, which share more of them."""
    drive = SurveyedDrive(seed, NOISE, scans=600, objects=80)
    labels = [drive.object[drive.scan == number] for number in np.unique(drive.scan)]
    unique = [replace(scan, labels=each) for scan, each in zip(drive.scans, labels, strict=True)]
    assert find_unit(narrow(unique, 0.15)) == 1.0
