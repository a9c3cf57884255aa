"""Which frame detections are in: found by which scans agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.common.calibration import Calibration, DetectionCalibration
from slam.common.geometry import apply, invert
from slam.self_calibration.frames import better_frame
from slam.self_calibration.object_tracks import SurveyScan
from slam.self_calibration.scan_pairs import spacing_of
from slam.self_calibration.survey import Survey, survey
from slam.self_calibration.surveyed_log import SurveyedLog
from tests.helpers.surveyed_drives import NOISE, SurveyedDrive, records_of


@pytest.fixture(scope="module")
def drive() -> SurveyedDrive:
    return SurveyedDrive(0, NOISE, scans=400, objects=60)


def fixed(scans: list[SurveyScan]) -> list[SurveyScan]:
    """The scans with positions in the frame of the odometry."""
    return [replace(scan, positions=apply(scan.T_odom_body, scan.positions)) for scan in scans]


def surveyed(scans: list[SurveyScan], frame: str, detection: DetectionCalibration | None = None) -> Survey:
    given = Calibration() if detection is None else Calibration(detection=detection)
    found = survey([SurveyedLog.of(records_of(scans, frame))], given)
    assert found is not None
    return found


@pytest.mark.slow
@pytest.mark.parametrize("is_fixed", [False, True])
@pytest.mark.parametrize("frame", ["odom", "base_link"])
def test_the_frame_in_which_objects_stand_still_is_found_whatever_messages_say(drive, is_fixed, frame):
    scans = fixed(drive.scans) if is_fixed else drive.scans
    found = surveyed(scans, frame)
    right = "odom" if is_fixed else "base_link"
    setting = "assume_odometry_frame" if is_fixed else "assume_body_frame"
    assert found.corrected == ({} if frame == right else {f"detection.{setting}": True})
    assert found.max_range_m < 1.1 * drive.range_m


def test_a_frame_that_was_set_by_hand_is_kept(drive):
    by_hand = DetectionCalibration(assume_body_frame=True)
    found = surveyed(fixed(drive.scans), "base_link", by_hand)
    assert "detection.assume_odometry_frame" not in found.corrected
    assert found.max_range_m > 1.1 * drive.range_m  # in the right frame it is less


def test_objects_that_go_along_with_the_body_roughly_are_in_no_other_frame(drive):
    """As objects of a narrow view, of which another one is always ahead."""
    rng, spacing_m = np.random.default_rng(0), spacing_of(drive.scans)
    ahead = [replace(scan, positions=drive.scans[0].positions + rng.normal(scale=[[s, s, 0.0]], size=(1, 3)),
                     labels=drive.scans[0].labels) for scan in drive.scans for s in [0.2 * spacing_m]]  # fmt: skip
    fixed_ahead = [replace(scan, positions=apply(invert(scan.T_odom_body), scan.positions)) for scan in ahead]
    assert better_frame(ahead, {"fixed": fixed_ahead}) is None
    assert better_frame(ahead, {"fixed": [replace(e, positions=apply(invert(e.T_odom_body), drive.scans[0].positions))
                                          for e in ahead]}) == "fixed"  # fmt: skip


def test_without_scans_no_frame_is_found():
    assert better_frame([], {"fixed": []}) is None


@pytest.mark.slow
@pytest.mark.parametrize("turns", [False, True])
def test_odometry_without_orientations_is_found_by_the_objects_that_do_not_stand_still(turns):
    drive = SurveyedDrive(0, NOISE, scans=600, objects=80, turns=turns)
    scans = [replace(scan, T_odom_body=np.eye(4)) for scan in drive.scans]
    for scan, known in zip(scans, drive.scans, strict=True):
        scan.T_odom_body[:3, 3] = known.T_odom_body[:3, 3]
    assert surveyed(scans, "base_link").lacks_heading == turns
    assert not surveyed(drive.scans, "base_link").lacks_heading
