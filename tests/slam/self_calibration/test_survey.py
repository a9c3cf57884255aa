"""What the beginning of a log tells: ranges, spacing, motion and noise."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.messages import ObjectDetections, Odometry, Record, Transform
from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration, DetectionCalibration, ObjectCalibration, OdometryCalibration
from slam.common.geometry import apply, invert
from slam.self_calibration.corrections import Correction
from slam.self_calibration.survey import ANGLES_DEG, Survey, _of_sensor, _unknown
from slam.self_calibration.survey import survey as survey_logs
from slam.self_calibration.surveyed_log import SurveyedLog
from slam.self_calibration.variance_components import ComponentEstimate, NoiseComponents
from slam.simulation.faults.recording import joined
from tests.helpers.landmarks import detections_of
from tests.helpers.poses import motion_by, pose_at
from tests.helpers.surveyed_drives import NOISE, SurveyedDrive, records_of, summary_of, with_odometry

ON_BODY = DetectionCalibration(assume_body_frame=True)
ROW = np.array([[4.0, 3.0, 0.0], [8.0, 6.0, 0.0], [12.0, 16.0, 0.0]])
"""At ranges of 5 m, 10 m and 20 m."""


def survey(records, detection: DetectionCalibration | None = None, **branches) -> Survey | None:
    """The survey of one log."""
    return survey_logs([SurveyedLog(records)], Calibration(detection=detection or DetectionCalibration(), **branches))


def odometry(seconds: float, x: float, yaw: float = 0.0) -> Odometry:
    T = pose_at(x, yaw=yaw)
    return Odometry(round(seconds * 1e9), T, child_frame_id="base_link")


def detections(seconds: float, positions=ROW, labels=(), *, frame="base_link", **fields) -> ObjectDetections:
    return detections_of(positions, labels, stamp_ns=round(seconds * 1e9), frame_id=frame, **fields)


def straight(scans: int = 11, **fields) -> list[Record]:
    """Along x at 2 m/s, ten scans a second, always the same detections."""
    records: list[Record] = []
    for i in range(scans):
        records += [odometry(0.1 * i, 0.2 * i), detections(0.1 * i, **fields)]
    return records


def test_ranges_times_and_motion_are_those_of_the_log():
    found = survey(straight())
    assert (found.scans, found.detections, found.objects) == (11, 33, 3.0)
    assert found.median_range_m == pytest.approx(10.0)
    assert found.max_range_m == pytest.approx(20.0)
    assert found.range_m == pytest.approx(np.quantile([5.0, 10.0, 20.0] * 11, 0.95))
    assert found.interval_s == pytest.approx(0.1)
    assert found.travel_m == pytest.approx(2.0)


def test_spacing_is_that_of_objects_of_one_class():
    assert survey(straight()).spacing_m == pytest.approx(5.0)
    assert survey(straight(labels=["tree", "lamp", "tree"])).spacing_m == pytest.approx(np.hypot(8.0, 13.0))
    assert np.isnan(survey(straight(labels=["tree", "lamp", "sign"])).spacing_m)


def test_ranges_are_horizontal_and_from_the_body():
    T_body_sensor = pose_at(1.0, z=7.0, yaw=np.pi / 2)
    mounted = Transform(0, "base_link", "lidar", T_body_sensor)
    found = survey([mounted, *straight(positions=[[0.0, -4.0, -5.0]], frame="lidar")])
    assert found.max_range_m == pytest.approx(5.0)


def test_a_scan_in_a_frame_that_nobody_knows_is_left_out_unless_it_is_taken_for_the_body():
    assert survey(straight(frame="lidar")) is None
    assert survey(straight(frame="lidar"), ON_BODY).scans == 11


def test_a_tilted_body_sees_upright():
    """It pitches by 0.3 rad: what is 10 m ahead of it is nearer in the plane."""
    tilted = motion_by([0.0, 0.3, 0.0])
    records: list[Record] = []
    for i in range(3):
        records += [replace(odometry(0.1 * i, 0.0), T_odom_body=tilted), detections(0.1 * i, [[10.0, 0.0, 0.0]])]
    assert survey(records).max_range_m == pytest.approx(10.0 * np.cos(0.3))


def test_detections_below_the_least_score_or_without_a_place_count_nothing():
    scores = np.array([0.9, 0.2, 0.9])
    found = survey(straight(scores=scores), DetectionCalibration(min_score=0.5))
    assert found.detections == 22
    assert survey(straight(positions=[*ROW[:2], [np.nan, 0.0, 0.0]])).detections == 22


def test_scans_outside_the_odometry_and_empty_ones_are_left_out():
    records = [*straight(), detections(-1.0), detections(9.0), detections(0.55, np.zeros((0, 3)))]
    assert survey(records).scans == 11


def test_odometry_that_goes_back_in_time_is_left_out():
    records = straight()
    assert survey([*records, odometry(0.5, 500.0)]).travel_m == pytest.approx(2.0)


@pytest.mark.parametrize(
    "records", [[], [detections(0.0)], [odometry(0.0, 0.0)], [odometry(0.0, 0.0), odometry(1.0, 1.0)]]
)
def test_without_odometry_or_detections_there_is_no_survey(records):
    assert survey(records) is None


def test_it_reads_no_more_than_it_needs():
    def endless():
        yield from straight()
        raise AssertionError("read on")

    found = survey_logs([SurveyedLog(endless(), max_detections=9)], Calibration())
    assert found.detections <= 9


def test_several_logs_are_surveyed_as_one_drive():
    first, second = straight(), straight(21, labels=["lamp", "lamp", "tree"])
    both = survey_logs([SurveyedLog(first), SurveyedLog(second)], Calibration())
    assert (both.scans, both.detections) == (32, 96)
    assert both.travel_m == pytest.approx(2.0 + 4.0)


def test_motion_at_scans_is_that_of_the_odometry_around_them():
    """Turning through half a turn; at the ends, on one side."""
    records: list[Record] = []
    for i in range(40):
        records += [odometry(0.1 * i, 0.2 * i, 3.0 + 0.05 * i), detections(0.1 * i)]
    _, motion = SurveyedLog(records).scans(Calibration(), {})
    np.testing.assert_allclose(motion.velocities, np.tile([2.0, 0.0], (40, 1)))
    np.testing.assert_allclose(motion.turn_rates, 0.5)


def test_odometry_that_repeats_poses_moves_all_the_same():
    """Each pose three times, 1 m apart, but that at 5 m fifteen times, where the body stands."""
    x = np.repeat(np.arange(10.0), [15 if i == 5 else 3 for i in range(10)])
    log = SurveyedLog([odometry(i, each) for i, each in enumerate(x)])
    at = log.poses_at(10**9 * np.arange(36), Calibration(), 0.0)[:, 0, 3]
    np.testing.assert_allclose(at[:16], np.arange(16) / 3.0)
    np.testing.assert_allclose(at[16:30], 5.0)


def test_false_detections_are_told_by_noise_and_the_change_of_the_view(monkeypatch):
    of_10_m = {"radial_by_range": 1e-4, "tangential_by_range": 2e-4}
    noise = NoiseComponents(radial=0.02, tangential=0.03, view=0.05, **of_10_m)
    found = ComponentEstimate(noise, NoiseComponents(), 1000)
    monkeypatch.setattr("slam.self_calibration.survey.estimate_components", lambda *_: found)
    monkeypatch.setattr("slam.self_calibration.survey.clutter_density", lambda scans, tracked, sigma_m: sigma_m)
    assert survey(straight()).clutter_density == pytest.approx(0.3)


def test_the_variance_that_messages_claim_is_compared_with_that_which_they_have():
    drive = SurveyedDrive(0, {"radial": 0.1, "tangential": 0.1}, scans=200, objects=30)
    scans = [replace(scan, variances=np.full(len(scan.labels), 0.2**2)) for scan in drive.scans]
    assert summary_of(scans).claimed_ratio == pytest.approx((0.1 / 0.2) ** 2, rel=0.3)
    assert np.isnan(summary_of(drive.scans).claimed_ratio)


def test_a_body_that_leans_changes_the_noise_of_heights_only_where_none_are_measured():
    level = SurveyedDrive(0, NOISE, scans=300, objects=60).scans
    leaning = []
    for number, scan in enumerate(level):
        tilt = motion_by([0.05 * np.sin(number), 0.0, 0.0])
        positions = scan.positions @ tilt[:3, :3].T
        leaning.append(replace(scan, T_odom_body=scan.T_odom_body @ tilt, positions=positions))
    found, usual = (summary_of(scans).components for scans in (leaning, level))
    assert found.variances.tangential == pytest.approx(usual.variances.tangential, rel=0.1)
    assert found.variances.tilt_by_travel == usual.variances.tilt_by_travel == 0.0
    heights = np.concatenate([scan.positions[:, 2] for scan in leaning])
    assert usual.variances.rise == 0.0
    assert found.variances.rise == pytest.approx(np.var(heights), rel=0.3)


def test_absurd_positions_do_not_hide_that_a_sensor_measures_heights():
    rng, scans = np.random.default_rng(0), SurveyedDrive(0, NOISE, scans=200, objects=60).scans
    high = [
        replace(scan, positions=scan.positions + rng.normal(0.0, [0.0, 0.0, 0.1], (len(scan.labels), 3)))
        for scan in scans
    ]
    wild = [replace(scan, positions=scan.positions.copy()) for scan in high]
    for scan in wild:
        scan.positions[0, 0] = 1e9
    found, usual = (summary_of(each).components for each in (wild, high))
    assert found.variances.height == pytest.approx(usual.variances.height, rel=0.2)
    assert usual.variances.height == pytest.approx(0.1**2, rel=0.3)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_lengths_of_a_survey_scale_with_the_log(scale):
    small, large = (
        summary_of(SurveyedDrive(0, {"radial": 0.1}, scans=60, objects=30, scale=factor).scans)
        for factor in (1.0, scale)
    )
    lengths = "range_m", "median_range_m", "max_range_m", "spacing_m", "travel_m"
    for name in (*lengths, "scans", "detections", "objects", "interval_s"):
        expected = getattr(small, name) * (scale if name in lengths else 1.0)
        assert getattr(large, name) == pytest.approx(expected), name


def turned_records(yaw_deg: float, *, scans: int = 600, objects: int = 100) -> list[Record]:
    """A drive whose sensor is turned by an angle that no transform tells."""
    records = records_of(SurveyedDrive(0, NOISE, scans=scans, objects=objects).scans)
    return turned(records, "z", yaw_deg)


def short_records() -> list[Record]:
    """Where it matters little what the drive tells."""
    return turned_records(0.0, scans=60, objects=15)


def moved(change: Callable[[FloatArray], FloatArray], records: list[Record]) -> list[Record]:
    """Records whose detections are elsewhere."""
    return [
        replace(each, positions=change(each.positions)) if isinstance(each, ObjectDetections) else each
        for each in records
    ]


def turned(records: list[Record], axis: str, angle_deg: float) -> list[Record]:
    R = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    return moved(lambda positions: positions @ R, records)


def pitched_records(pitch_deg: float) -> list[Record]:
    """Seen by a sensor that pitches, what is ahead is nearer, as if the odometry were too long."""
    return turned(turned_records(0.0), "y", pitch_deg)


def scaled_records(length: float, climb: float = 0.0) -> list[Record]:
    """A drive whose odometry has its lengths multiplied by a factor, or climbs among objects of rough heights."""
    rng, records = np.random.default_rng(0), with_odometry(turned_records(0.0), length_scale=length, climb=climb)
    return moved(lambda xyz: xyz + [0.0, 0.0, 0.05 * bool(climb)] * rng.normal(size=xyz.shape), records)


def shifted_records(shift_m: float) -> list[Record]:
    """Of a sensor that sits to the left by so much."""
    return moved(lambda positions: positions - [0.0, shift_m, 0.0], turned_records(0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "wrong", "key", "right", "tolerance"),
    [
        *((turned_records, yaw_deg, "detection.yaw_deg", yaw_deg, 2.0) for yaw_deg in (-25.0, 0.0, 100.0)),
        *((pitched_records, pitch_deg, "detection.pitch_deg", pitch_deg, 1.5) for pitch_deg in (15.0, -10.0)),
        *((partial(scaled_records, 1.0), climb, "odometry.climb", -climb, 0.002) for climb in (0.1, -0.02)),
        *((scaled_records, length, "odometry.length_scale", 1.0 / length, 0.01) for length in (1.2, 0.8)),
        (scaled_records, 1000.0, "odometry.length_scale", 0.001, 1e-5),
        (shifted_records, -1.5, "detection.y_m", -1.5, 0.1),
    ],
)
def test_a_systematic_error_is_corrected_and_nothing_else(make, wrong, key, right, tolerance):
    expected = {key: pytest.approx(right, abs=tolerance)} if right else {}
    corrected = survey(make(wrong), ON_BODY).corrected
    assert {name: value for name, value in corrected.items() if value} == expected


def doubled(records: list[Record]) -> list[Record]:
    """With a second detection of each object, off by 0.1 m."""
    rng = np.random.default_rng(0)
    return [
        joined([each, replace(each, positions=each.positions + rng.normal(0.0, 0.1, each.positions.shape))])
        if isinstance(each, ObjectDetections)
        else each
        for each in records
    ]


def test_an_object_that_is_detected_twice_is_one_unless_a_resolution_was_given():
    records = doubled(turned_records(0.0, scans=150, objects=40))
    found = survey(records, ON_BODY)
    assert 0.3 < found.corrected["detection.resolution_m"] < 1.5
    assert found.spacing_m > found.corrected["detection.resolution_m"]
    given = DetectionCalibration(assume_body_frame=True, resolution_m=0.0)
    assert "detection.resolution_m" not in survey(records, given).corrected


def test_lengths_of_another_unit_are_corrected_to_the_last_percent_unless_a_scale_was_given():
    """By 1 / 1300, of which the octave is 1 / 1024."""
    records = with_odometry(turned_records(0.0, scans=300, objects=60), length_scale=1300.0)
    assert survey(records, ON_BODY).corrected["odometry.length_scale"] == pytest.approx(1.0 / 1300.0, rel=0.02)
    given = OdometryCalibration(length_scale=1.0)
    assert "odometry.length_scale" not in survey(records, ON_BODY, odometry=given).corrected


def test_a_unit_is_sought_only_where_no_orientation_fits(monkeypatch):
    """In regular rows, wrong lengths may fit in wrong axes."""
    monkeypatch.setattr("slam.self_calibration.survey.find_unit", lambda _: 0.5)
    corrected = survey(turned_records(180.0, scans=300, objects=60), ON_BODY).corrected
    assert corrected["detection.yaw_deg"] == pytest.approx(180.0)
    assert "odometry.length_scale" not in corrected


def test_sensor_that_is_turned_on_the_way_is_told():
    before, after = (turned_records(yaw_deg, scans=600, objects=60) for yaw_deg in (0.0, 20.0))
    middle_ns = (before[0].stamp_ns + before[-1].stamp_ns) // 2
    records = [a if a.stamp_ns < middle_ns else b for a, b in zip(before, after, strict=True)]
    found, steady = survey(records, ON_BODY), survey(before, ON_BODY)
    assert (steady.change, steady.change_s) == (None, 0.0)
    assert (found.change.term, found.change.value) == ("yaw_rad", pytest.approx(np.deg2rad(20.0), abs=0.05))
    assert found.change_s == pytest.approx((middle_ns - before[0].stamp_ns) * 1e-9, rel=0.2)


@pytest.mark.parametrize(("climb", "is_corrected"), [(1e-9, False), (0.1, True)])
def test_climb_that_may_be_chance_is_suspected_only(monkeypatch, climb, is_corrected):
    monkeypatch.setattr("slam.self_calibration.survey.find_alignment", lambda *_: ({"climb_share": -0.1}, {}))
    given = DetectionCalibration(assume_body_frame=True, pitch_deg=0.0)
    found = survey(scaled_records(1.0, climb), given)
    told = found.corrected if is_corrected else found.suspected
    assert told["odometry.climb"] == pytest.approx(-0.1)
    assert ("odometry.climb" in found.corrected) == is_corrected


def test_turn_of_an_alignment_is_measured_by_followed_objects(monkeypatch):
    """At one speed, so that a turn by the way would explain the rest as well."""
    monkeypatch.setattr("slam.self_calibration.survey.find_alignment", lambda *_: ({"drift_rad_per_s": -0.03}, {}))
    found = survey(with_odometry(turned_records(0.0), drift_deg_per_s=3.0), ON_BODY)
    assert found.corrected == {"odometry.drift_deg_per_s": pytest.approx(-3.0, abs=0.1)}


def test_drift_of_an_alignment_adds_to_that_which_is_known():
    known = Calibration(odometry=OdometryCalibration(drift_deg_per_s=1.5))
    assert _of_sensor({"drift_rad_per_s": np.deg2rad(-2.0)}, known) == {"odometry.drift_deg_per_s": pytest.approx(-0.5)}
    assert "drift_rad_per_s" not in _unknown(known)
    assert "drift_rad_per_s" in _unknown(Calibration())


def test_angles_of_an_alignment_turn_a_sensor_as_it_is_mounted():
    """It hangs upside down, and pitches."""
    mounted = Calibration(detection=DetectionCalibration(roll_deg=180.0))
    angles_deg = _of_sensor({"pitch_rad": 0.3}, mounted)
    found = Rotation.from_euler("xyz", [angles_deg[key] for key in ANGLES_DEG], degrees=True)
    right = Rotation.from_euler("y", 0.3) * Rotation.from_euler("x", np.pi)
    np.testing.assert_allclose(found.as_matrix(), right.as_matrix(), atol=1e-9)


@pytest.mark.parametrize(("bias_m", "shifts"), [(0.2, {"detection.x_m": 0.5}), (-0.6, {})])
def test_a_shift_is_not_corrected_where_a_larger_bias_of_ranges_fits(monkeypatch, bias_m, shifts):
    shift, bias = Correction("x_m", 0.5, 0.2, True), Correction("near_m", bias_m, 0.0, False)
    found = iter([(shift, bias)])
    monkeypatch.setattr("slam.self_calibration.survey.estimate_corrections", lambda *_: next(found, ()))
    surveyed = survey(short_records(), ON_BODY)
    assert surveyed.corrected == shifts
    assert surveyed.suspected == ({} if shifts else {"detection.x_m": 0.5})


@pytest.mark.parametrize(
    ("corrections", "corrected"),
    [
        pytest.param([("turn_share", 0.6, True)], {}, id="no odometry turns so much too little"),
        pytest.param([("length_share", -0.63, True)], {}, id="objects seem to move with the body"),
        pytest.param([("y_m", -38.0, True)], {}, id="no sensor is so far from the body"),
        pytest.param(
            [("turn_share", 0.2, True), ("turn_share", 0.01, False)], {"odometry.turn_scale": 1.212}, id="rest of turns"
        ),
        pytest.param([("turn_share", 0.02, True)], {}, id="a small share is no matter"),
    ],
)
def test_corrections_are_those_that_a_calibration_can_make(monkeypatch, corrections, corrected):
    """Of a term, its value, and whether it explains much."""
    found = iter([Correction(term, value, 0.2 if much else 0.0, True) for term, value, much in corrections])
    monkeypatch.setattr("slam.self_calibration.survey.estimate_corrections", lambda *_: tuple(islice(found, 1)))
    surveyed = survey(short_records(), ON_BODY)
    assert {key: value for key, value in surveyed.corrected.items() if value} == pytest.approx(corrected, abs=0.001)


@pytest.mark.parametrize("frame", ["base_link", "odom"])
def test_odometry_frame_that_is_not_level_is_turned_unless_it_was_given(frame):
    level = OdometryCalibration(roll_deg=20.0, pitch_deg=-30.0)
    records: list[Record] = []
    for k in range(8):
        T = invert(level.T_level_odom) @ pose_at(0.1 * k, yaw=0.5 * k)
        at = apply(T, ROW) if frame == "odom" else ROW
        records += [Odometry(k * 10**8, T, "odom", "base_link"), detections(0.1 * k, at, frame=frame)]
    found = survey(records)
    assert found.corrected == pytest.approx({"odometry.roll_deg": 20.0, "odometry.pitch_deg": -30.0})
    assert found.max_range_m == pytest.approx(20.0)
    assert survey(records, odometry=OdometryCalibration(roll_deg=0.0)).corrected == {}


def test_an_angle_that_was_set_by_hand_is_kept():
    by_hand = DetectionCalibration(assume_body_frame=True, yaw_deg=5.0)
    found = survey(turned_records(25.0, scans=200, objects=40), by_hand)
    assert found.corrected == {}


def test_labels_beyond_the_most_classes_are_one_class():
    records = straight(labels=["tree", "lamp", "sign"])
    assert np.isnan(survey(records, objects=ObjectCalibration(max_classes=3)).spacing_m)
    assert np.isfinite(survey(records, objects=ObjectCalibration(max_classes=2)).spacing_m)


def test_an_odometry_that_goes_back_and_forth_makes_a_detour():
    assert survey(straight()).detour == pytest.approx(1.0, abs=0.1)
    there_and_back = [odometry(0.1 * i, 0.1 * i + (i % 2)) for i in range(21)]
    found = survey([*there_and_back, detections(1.0)])
    assert found.detour > 5.0
    assert found.interval_s == 0.0  # of one scan
    assert survey([odometry(0.0, 1.0), odometry(1.0, 1.0), detections(0.5)]).detour == 1.0
    wild = [odometry(0.1 * i, 0.1 * i + 1000.0 * (i == 51)) for i in range(101)]
    assert survey([*wild, detections(1.0)]).detour < 1.2


def test_of_messages_with_one_stamp_the_first_is_surveyed():
    later = [each for each in straight() if isinstance(each, ObjectDetections)]
    twice = [replace(each, positions=each.positions + 1.0) for each in later]
    found, expected = survey([*straight(), *twice]), survey(straight())
    assert (found.scans, found.range_m) == (expected.scans, expected.range_m)
