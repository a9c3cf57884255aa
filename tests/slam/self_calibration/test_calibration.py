"""Settings from a survey: what is derived, what is left alone, and what is assumed where a log tells nothing."""

from dataclasses import replace

import numpy as np
import pytest

from slam.common.calibration import Calibration, ObjectCalibration, OdometryCalibration
from slam.common.config import SUBMAP_RANGES, Config
from slam.common.config_tree import settings_of
from slam.common.errors import InputDataError
from slam.frontend.input.stamp_clocks import LoggingDelays
from slam.self_calibration.calibration import MIN_DRIFT, MIN_TURN_RAD, calibrate
from slam.self_calibration.corrections import TERMS, Change
from slam.self_calibration.object_tracks import Detectability
from slam.self_calibration.survey import LabelNoise, Survey
from slam.self_calibration.variance_components import ComponentEstimate, NoiseComponents
from tests.helpers.surveyed_drives import SurveyedDrive, summary_of

NOISE = {"radial": 0.1, "tangential": 0.1, "translation_by_travel": 0.05, "heading_by_turn": 0.03}


def settings() -> dict[str, str]:
    """Description of each setting by its name, "branch.setting"."""
    return {each.key: each.meaning for each in settings_of(Calibration()) if "." in each.key}


def value_of(config: Config, key: str) -> object:
    branch, name = key.split(".")
    return getattr(getattr(config.calibration, branch), name)


@pytest.fixture(scope="module")
def surveyed() -> Survey:
    return summary_of(SurveyedDrive(0, NOISE, scans=500, objects=60).scans)


def scaled(survey: Survey, factor: float) -> Survey:
    """The lengths of a survey without components, times ``factor``."""
    names = ("range_m", "median_range_m", "max_range_m", "spacing_m", "travel_m")
    return replace(survey, components=None, **{name: factor * getattr(survey, name) for name in names})


def with_noise(survey: Survey, **variances: float) -> Survey:
    """The survey of a log that has these variances for certain, and no others."""
    return replace(survey, components=ComponentEstimate(NoiseComponents(**variances), NoiseComponents(), 1000))


def with_errors(survey: Survey, **variances: float) -> Survey:
    """The survey of a log whose noise is known with these standard errors."""
    assert survey.components is not None
    errors = replace(survey.components.standard_errors, **variances)
    return replace(survey, components=replace(survey.components, standard_errors=errors))


def calibrated(survey: Survey) -> Calibration:
    return calibrate(Config(), survey).config.calibration


def notes(survey: Survey) -> str:
    return "\n".join(calibrate(Config(), survey).notes)


# Which settings


def test_every_setting_in_metres_is_derived(surveyed):
    """By its description: one that is added must be derived, too, or be named here with a reason."""
    units = ("[m]", "[m/s]", "[m/s^2]", "[1/m^3]", "[m / sqrt(m)]", "[rad / sqrt(m)]", "[m / sqrt(s)]")
    in_metres = {key for key, description in settings().items() if description.endswith(units)}
    derived = set(calibrate(Config(), surveyed).estimated)
    # Gravity holds roll and pitch, and detections do not tell them; how a robot is built is not in its log.
    stay = {"detection.ground_z_m", "detection.tag_size_m", "detection.max_range_m"}
    stay |= {"objects.height_sigma_m"}
    # Corrections are made where the log needs them only.
    stay |= {"detection.x_m", "detection.y_m", "detection.resolution_m"}
    assert in_metres - derived == stay


@pytest.mark.parametrize("key", ["odometry.yaw_sigma", "detection.common_sigma_m"])
def test_what_was_set_by_hand_stays(surveyed, key):
    branch, name = key.split(".")
    by_hand = 0.0123
    found = calibrate(Config.model_validate({"calibration": {branch: {name: by_hand}}}), surveyed)
    assert value_of(found.config, key) == by_hand
    assert key not in found.estimated
    others = calibrate(Config(), surveyed).estimated
    assert set(found.estimated) == set(others) - {key}


@pytest.mark.parametrize("range_m", [30.0, 60.0], ids=["default", "another"])
def test_a_range_that_was_set_by_hand_decides_the_lengths(surveyed, range_m):
    given = Config.model_validate({"calibration": {"detection": {"sensor_range_m": range_m}}})
    found = calibrate(given, scaled(surveyed, 100.0)).config
    assert found.keyframe_distance_m == pytest.approx(range_m / 30.0 * Config().keyframe_distance_m)


@pytest.mark.parametrize("factor", [1e-320, 1e-100, 1e100])
def test_lengths_beyond_all_numbers_are_refused(surveyed, factor):
    with pytest.raises(InputDataError, match=r"objects are seen at .* m; give their positions in metres"):
        calibrate(Config(), scaled(surveyed, factor))


def test_without_a_survey_everything_stays():
    found = calibrate(Config(), None)
    assert found.config == Config()
    assert found.estimated == {}


# How large


def test_every_derived_setting_is_one_that_may_be_set_by_hand(surveyed):
    """The configuration of a log is read back from it."""
    for survey in (surveyed, scaled(surveyed, 1.0), scaled(surveyed, 1e-3), scaled(surveyed, 1e3)):
        found = calibrate(Config(), survey).config
        assert Config.model_validate_json(found.model_dump_json()) == found


@pytest.mark.parametrize("power", [-8, 10])
def test_all_lengths_scale_with_the_log(surveyed, power):
    factor = 2.0**power
    small = calibrate(Config(), scaled(surveyed, 1.0)).estimated
    large = calibrate(Config(), scaled(surveyed, factor)).estimated
    of_lengths = ("sensor_range_m", "farthest_m", "base_sigma_m", "common_sigma_m")
    powers = {"objects.new_object_density": -3.0, "objects.spacing_m": 1.0, "objects.landmark_sigma_m": 1.0}
    powers |= dict.fromkeys((f"detection.{name}" for name in of_lengths), 1.0) | {"detection.sigma_per_m": 0.0}
    powers |= {"odometry.translation_sigma": 0.5, "odometry.yaw_sigma": -0.5, "odometry.yaw_sigma_by_turn": 0.0}
    for key, of_length in powers.items():
        assert large[key] == pytest.approx(small[key] * factor**of_length), key


def test_little_data_make_the_noise_large(surveyed):
    """One standard error is added to each variance."""
    doubtful = with_errors(surveyed, tangential=1.0, translation_by_travel=1.0)
    sure, unsure = calibrated(surveyed), calibrated(doubtful)
    assert unsure.detection.base_sigma_m > 2.0 * sure.detection.base_sigma_m
    assert unsure.odometry.translation_sigma > 2.0 * sure.odometry.translation_sigma


def test_where_a_log_tells_nothing_of_its_noise_it_is_taken_to_be_large(surveyed):
    told, untold = calibrated(surveyed), calibrated(replace(surveyed, components=None))
    range_m = surveyed.range_m
    assert untold.detection.base_sigma_m == pytest.approx(0.02 * range_m)
    assert untold.odometry.translation_sigma == pytest.approx(0.05 * np.sqrt(range_m))
    assert untold.odometry.yaw_sigma == pytest.approx(0.2 / np.sqrt(range_m))
    assert untold.odometry.yaw_sigma_by_turn > told.odometry.yaw_sigma_by_turn
    assert untold.evidence["pairs"] == 0


def test_an_estimate_of_zero_leaves_a_least_heading_noise(surveyed):
    found = calibrated(with_noise(surveyed)).odometry
    assert found.yaw_sigma * np.sqrt(surveyed.range_m) == pytest.approx(MIN_TURN_RAD)
    assert found.translation_sigma * np.sqrt(surveyed.range_m) == pytest.approx(MIN_DRIFT * surveyed.range_m)


def test_standard_errors_of_noise_are_those_of_a_root(surveyed):
    found = calibrated(surveyed)
    for key, name in (
        ("detection.base_sigma_m", "tangential"),
        ("odometry.translation_sigma", "translation_by_travel"),
    ):
        error = getattr(surveyed.components.standard_errors, name)
        assert found.sigmas[key] == pytest.approx(0.5 * error / value_of(Config(calibration=found), key))


def test_landmarks_of_two_passes_are_apart_by_the_view_and_by_the_drift_over_half_a_submap(surveyed):
    found = calibrated(with_noise(surveyed, view=0.01, translation_by_travel=0.02))
    expected = 0.01 + 0.5 * SUBMAP_RANGES * surveyed.range_m * 0.02
    assert found.objects.landmark_sigma_m == pytest.approx(np.sqrt(expected))


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("odometry.translation_sigma", "translation_by_travel"),
        ("odometry.translation_sigma_by_time", "translation_by_time"),
        ("odometry.yaw_sigma", "heading_by_travel"),
        ("odometry.yaw_sigma_by_time", "heading_by_time"),
        ("odometry.yaw_sigma_by_turn", "heading_by_turn"),
        ("detection.stamp_sigma_s", "stamps"),
    ],
)
def test_noise_is_that_of_the_survey(surveyed, key, name):
    found = calibrated(with_noise(surveyed, **{name: 0.04}))
    assert value_of(Config(calibration=found), key) == pytest.approx(0.2)


@pytest.mark.parametrize("name", ["rise", "rise_by_travel"])
def test_heights_that_vary_in_common_are_not_averaged_out_by_many_objects(surveyed, name):
    over_m = 1.0 if name == "rise" else surveyed.median_range_m
    steady, swaying = with_noise(surveyed), with_noise(surveyed, **{name: 0.04 / over_m})
    found = calibrated(swaying)
    assert found.detection.height_sigma_m / np.sqrt(surveyed.objects) == pytest.approx(0.2)
    assert found.objects.landmark_height_sigma_m == pytest.approx(0.2 * np.sqrt(2.0))
    assert calibrated(steady).detection.height_sigma_m == 0.0, "as the position says"


def test_noise_of_heights_is_what_they_have_beyond_the_noise_across_the_ray(surveyed):
    by_range = 0.05 / surveyed.median_range_m**2
    noisy = with_noise(surveyed, tangential=0.04, tangential_by_range=by_range, height=0.5**2, view_height=0.09)
    assert calibrated(noisy).detection.height_sigma_m == pytest.approx(0.4)
    assert calibrated(noisy).objects.landmark_height_sigma_m == pytest.approx(0.5)
    exact = calibrated(with_noise(surveyed, tangential=0.3**2, height=0.1**2))
    assert exact.detection.height_sigma_m == exact.objects.landmark_height_sigma_m == 0.0


def test_objects_that_are_never_two_of_a_class_cannot_be_confused(surveyed):
    alone = calibrated(replace(surveyed, spacing_m=float("nan")))
    assert alone.objects.spacing_m > 100.0 * surveyed.range_m
    assert calibrated(surveyed).objects.spacing_m == surveyed.spacing_m


@pytest.mark.parametrize("change", [{"travel_m": 0.0}, {"scans": 1}])
def test_a_robot_that_stands_still_has_finite_settings(surveyed, change):
    found = calibrate(Config(), replace(surveyed, **change))
    assert np.isfinite(list(found.estimated.values())).all()
    Config.model_validate_json(found.config.model_dump_json())


def test_noise_by_travel_is_limited_where_the_robot_stands(surveyed):
    names = "translation_by_travel", "heading_by_travel", "heading_by_turn", "heading_by_time", "tilt_by_travel"
    calibration = calibrated(with_noise(surveyed, **dict.fromkeys(names, 1e12), stamps=1e12))
    assert calibration.detection.stamp_sigma_s == pytest.approx(surveyed.interval_s)
    found = calibration.odometry
    by_travel = np.pi / np.sqrt(surveyed.range_m)
    assert found.translation_sigma == pytest.approx(np.sqrt(surveyed.range_m))
    assert (found.yaw_sigma, found.tilt_sigma) == pytest.approx((by_travel, by_travel))
    assert (found.yaw_sigma_by_turn, found.yaw_sigma_by_time) == pytest.approx((np.pi, np.pi))


# Faults of the input


UNKNOWN = LoggingDelays()


@pytest.mark.parametrize(("delay_s", "delays", "of_odometry", "of_detections"), [
    (0.05, UNKNOWN, -0.05, 0.0), (-0.2, UNKNOWN, 0.2, 0.0), (0.21, UNKNOWN, 0.0, 0.21), (-0.5, UNKNOWN, 0.0, -0.5),
    (-0.1, LoggingDelays(0.0, -0.1), 0.0, -0.1), (-0.1, LoggingDelays(0.2, 0.1), 0.1, 0.0),
])  # fmt: skip
def test_a_delay_is_one_of_the_odometry_up_to_two_scans_or_where_log_times_tell_so(
    surveyed, delay_s, delays, of_odometry, of_detections
):
    late = replace(surveyed, delay_s=delay_s, interval_s=0.1)
    calibration = calibrate(Config(), late, delays)
    assert calibration.config.calibration.odometry.time_offset_s == of_odometry
    assert calibration.config.calibration.detection.time_offset_s == of_detections
    (note,) = (note for note in calibration.notes if "off their stamps" in note)
    assert f"{of_odometry or of_detections:+.3f} s" in note


@pytest.mark.parametrize(("ratio", "factor"), [
    (0.2, 0.2**0.5), (0.26, 1.0), (1.0, 1.0), (3.9, 1.0), (9.0, 3.0), (float("nan"), 1.0),
])  # fmt: skip
def test_covariances_that_are_far_off_are_scaled(surveyed, ratio, factor):
    claiming = replace(surveyed, claimed_ratio=ratio)
    assert calibrated(claiming).detection.claimed_sigma_factor == pytest.approx(factor)
    assert ("scatter" in notes(claiming)) == (factor != 1.0)


def test_what_was_corrected_is_told_and_what_was_given_stays(surveyed):
    wrong = replace(surveyed, corrected={"odometry.turn_scale": 1.25, "detection.roll_deg": 180.0})
    for told in ("rotations of the odometry need a factor of 1.250: corrected", "has a roll of 180.0 deg"):
        assert told in notes(wrong)
    assert calibrated(wrong).odometry.turn_scale == 1.25
    by_hand = calibrate(Config(calibration=Calibration(odometry=OdometryCalibration(turn_scale=1.0))), wrong)
    assert by_hand.config.calibration.odometry.turn_scale == 1.0
    assert "turns" not in " ".join(by_hand.notes)
    assert notes(surveyed) == ""


def test_suspicions_are_notes_and_change_nothing(surveyed):
    calibration = calibrate(Config(), replace(surveyed, suspected={"detection.x_m": -0.3, "detection.roll_deg": -0.01}))
    assert "detection.x_m" not in calibration.estimated
    (note,) = calibration.notes
    assert note.endswith("suspected, not corrected (detection.x_m)")


def test_the_accuracy_of_labels_is_that_of_the_log(surveyed):
    objects = calibrated(replace(surveyed, labels=LabelNoise(0.7))).objects
    assert (objects.label_accuracy, objects.max_classes) == (0.7, ObjectCalibration().max_classes)


@pytest.mark.parametrize(
    ("labels", "told"), [(LabelNoise(0.1), "change at random"), (LabelNoise(0.9, True), "all at once")]
)
def test_labels_that_say_nothing_are_ignored_and_told(surveyed, labels, told):
    useless = replace(surveyed, labels=labels)
    assert calibrated(useless).objects.max_classes == 1
    assert told in notes(useless)


def test_noise_along_the_line_of_sight_is_told_from_that_across(surveyed):
    """As of a camera, which knows directions better than distances."""
    square_m = surveyed.median_range_m**2
    camera = with_noise(
        surveyed,
        radial=0.5, radial_by_range=1.5 / square_m, tangential=0.05, tangential_by_range=0.03 / square_m,
    )  # fmt: skip
    detection = calibrated(camera).detection
    assert detection.base_sigma_m == pytest.approx(0.05**0.5)
    assert detection.sigma_per_m == pytest.approx(0.03**0.5 / surveyed.median_range_m)
    assert detection.range_sigma_ratio == pytest.approx(5.0)


@pytest.mark.parametrize(("bias_m", "inflation"), [(0.0, 2.0), (0.3, 2.0 + 18.0)])
def test_inflation_counts_scans_while_the_view_changes_and_objects_that_share_a_bias(surveyed, bias_m, inflation):
    rare = replace(surveyed, scans=2, shared_bias_m=bias_m, objects=4.0, travel_m=surveyed.median_range_m)
    assert calibrated(with_noise(rare, view=0.04)).detection.covariance_inflation == pytest.approx(inflation)


def test_change_within_the_log_is_told(surveyed):
    change = Change("yaw_rad", np.deg2rad(15.0), 40)
    note = notes(replace(surveyed, change=change, change_s=61.2))
    assert note.startswith("about 61 s after the first scan, the sensor turns by a yaw of +15.0 deg: not corrected")


@pytest.mark.parametrize("term", TERMS)
def test_change_of_each_term_has_a_meaning(surveyed, term):
    note = notes(replace(surveyed, change=Change(term, -0.125, 1), change_s=1.0))
    assert any(value in note for value in ("-0.12", "-12.5%", "-7.2 deg", "-7.162 deg"))


@pytest.mark.parametrize(("detour", "told"), [(1.4, False), (1.6, True)])
def test_odometry_that_steps_back_and_forth_is_told(surveyed, detour, told):
    assert ("do two sources publish" in notes(replace(surveyed, detour=detour))) == told


@pytest.mark.parametrize(("period", "detected", "probability"), [(1, 0.2, 0.2), (3, 0.9, 0.3), (1, float("nan"), 1.0)])
def test_how_often_an_object_is_detected_is_that_of_the_log(surveyed, period, detected, probability):
    objects = calibrated(replace(surveyed, detectability=Detectability(period, detected))).objects
    assert objects.detection_probability == pytest.approx(probability)
    assert objects.detection_period == period


@pytest.mark.parametrize(("name", "of"), [("assume_odometry_frame", "odometry"), ("assume_body_frame", "body")])
def test_detections_in_another_frame_than_they_say_are_taken_from_it_and_told(surveyed, name, of):
    elsewhere = replace(surveyed, corrected={f"detection.{name}": True})
    assert getattr(calibrated(elsewhere).detection, name) is True
    assert f"detections are in the frame of the {of}" in notes(elsewhere)


# False detections


def test_false_detections_beyond_the_usual_make_new_objects_denser(surveyed):
    usual = calibrated(surveyed).objects.new_object_density
    few, many = (replace(surveyed, clutter_density=factor * usual) for factor in (0.5, 20.0))
    for survey, expected in ((few, usual), (many, 20.0 * usual), (replace(many, components=None), usual)):
        assert calibrated(survey).objects.new_object_density == expected


@pytest.mark.parametrize(
    ("tilt", "heading", "sigma"),
    [
        ((0.09, 0.01), (0.04, 0.01), np.sqrt(0.02)),  # the heading is known best
        ((0.04, 0.01), (0.09, 0.01), np.sqrt(0.02)),
        ((0.04, 0.03), (0.09, 0.01), 0.0003),  # the heights do not show it for certain
        ((0.04, 0.01), (0.0, 0.0), 0.0003),  # heights err alike
    ],
)
def test_tilt_noise_is_what_heights_and_headings_show_for_certain(surveyed, tilt, heading, sigma):
    noisy = with_noise(surveyed, tilt_by_travel=tilt[0], heading_by_travel=heading[0])
    noisy = with_errors(noisy, tilt_by_travel=tilt[1], heading_by_travel=heading[1])
    assert calibrated(noisy).odometry.tilt_sigma == pytest.approx(sigma)
