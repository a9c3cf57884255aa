"""Settings from a survey: lengths from the sensor range, noise from the variance components.

A setting that was given by hand stays as it is. Where the log tells too little, the noise is taken to be large: a prior
in units of the sensor range, not that of a good sensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from slam.common.calibration import DetectionCalibration, ObjectCalibration
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.frontend.input.stamp_clocks import LoggingDelays
from slam.object_map.submap import SUBMAP_RANGES
from slam.self_calibration.label_noise import LabelNoise
from slam.self_calibration.survey import NOTED_DETOUR, NOTED_SHARE, Survey
from slam.self_calibration.variance_components import NoiseComponents

PRIOR_NOISE = NoiseComponents(
    radial=0.02**2,
    radial_by_range=0.0,
    tangential=0.02**2,
    tangential_by_range=0.0,
    view=0.02**2,
    jitter=0.0,
    translation_by_travel=0.05**2,
    translation_by_time=0.0,
    heading_jitter=0.0,
    heading_by_travel=0.2**2,
    heading_by_turn=0.1**2,
    heading_by_time=0.0,
)
"""Variances where a log tells nothing, lengths in sensor ranges: detections are off by 2 % of the range, the odometry
by 5 % of it, and by 11 deg, after as much travel, and by 6 deg after turning by 1 rad.
"""
LEAST_DRIFT, LEAST_TURN_RAD = 0.01, 0.005
"""Detections cannot tell an odometry better than that: off by such a share of the sensor range after as much travel,
and by so many radians. An estimate of zero only says that the noise is below what detections show.
"""
LEAST_SIGMA = 1e-4
"""Least noise of a position, in sensor ranges."""
UNIQUE_SPACING = 1e3
"""Distance, in sensor ranges, between objects of a class of which no two share a scan."""
STAMPING_SCANS = 2.0
"""Where log times do not tell whose stamps are wrong: up to so many intervals between scans, a difference in time
between odometry and detections is a matter of how the odometry is stamped (of a step, its begin or its end), and the
odometry is moved; beyond that, detections were old when they were stamped.
"""
NOTED_FALSE = 0.5
"""Share of the detections from which those that belong to no object are noted."""
FEW_SCANS = 5.0
"""While an object comes from the median range to the body it should be seen so often."""
NO_DELAYS = LoggingDelays()
TURNS = ("roll_deg", "pitch_deg", "yaw_deg")
DEFAULT_RANGE_M = float(DetectionCalibration.model_fields["sensor_range_m"].get_default())
MOST_SCALE = 1e30
"""Lengths so many times the usual ones, or a part of them as small, are beyond float64 in their powers."""


@dataclass(frozen=True, slots=True)
class CalibratedLog:
    """``config``: the effective configuration; ``estimated``: the settings that the log decided, with their values;
    ``notes``: what that says of the log, for people.
    """

    config: Config
    estimated: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def calibrate(config: Config, survey: Survey | None, delays: LoggingDelays = NO_DELAYS) -> CalibratedLog:
    """The configuration for a log: settings that were not given by hand are derived from its survey.

    ``delays``: how long after their stamps messages were logged, which tells whose stamps are wrong.
    """
    if survey is None:
        return CalibratedLog(config, notes=("no detection lies on the odometry: nothing was estimated from the log",))
    values = _lengths(config, survey) | _noise(config, survey) | _corrections(survey, delays)
    estimated = {key: value for key, value in values.items() if not config.calibration.is_given(key)}
    return CalibratedLog(config.calibrated(estimated), estimated, _notes(config, survey, estimated))


def _sensor_range_m(config: Config, survey: Survey) -> float:
    if config.calibration.is_given("detection.sensor_range_m"):
        return config.sensor_range_m
    # The range is a coarse yardstick: what is of one size, like all cars, is to be treated alike.
    return float(DEFAULT_RANGE_M * 2.0 ** np.round(np.log2(survey.range_m / DEFAULT_RANGE_M)))


def _lengths(config: Config, survey: Survey) -> dict[str, float]:
    range_m = _sensor_range_m(config, survey)
    scale = range_m / DEFAULT_RANGE_M
    if not 1.0 / MOST_SCALE < scale < MOST_SCALE:
        raise InputDataError(f"objects are seen at {survey.range_m:.3g} m; give their positions in metres")
    usual = ObjectCalibration().new_object_density * scale**-3
    return {
        "detection.sensor_range_m": range_m,
        "detection.farthest_m": survey.max_range_m,
        "objects.new_object_density": max(usual, _false_density(survey)),
        "objects.spacing_m": survey.spacing_m if np.isfinite(survey.spacing_m) else UNIQUE_SPACING * range_m,
    }


def _false_density(survey: Survey) -> float:
    """Density of false detections [1/m^3]; 0 where too few objects could be tracked to tell them from others."""
    return survey.clutter.per_m3 if survey.components is not None else 0.0


def _notes(config: Config, survey: Survey, estimated: Mapping[str, float]) -> tuple[str, ...]:
    """What a user should know of the log: its faults, whether mended or not."""
    errors, notes = survey.errors, list[str]()
    for key, what in (("odometry.time_offset_s", "odometry"), ("detection.time_offset_s", "detection")):
        if offset_s := estimated.get(key, 0.0):
            age = "older" if offset_s < 0 else "newer"
            notes.append(f"{what} messages seem {abs(offset_s):.3f} s {age} than their stamps say: corrected ({key})")
    if survey.lacks_heading:
        notes.append(
            "the odometry's heading never changes, and objects do not stand still by it: it seems to hold positions "
            "only; record its orientations"
        )
    if survey.assumed_frame is not None:
        of = "body" if survey.assumed_frame == "assume_body_frame" else "odometry"
        notes.append(
            f"objects stand still if detections are in the frame of the {of}, and not in the one that their messages "
            f"name: taken to be (detection.{survey.assumed_frame}); check frame_id"
        )
    if any(survey.turned_deg) and not any(config.calibration.is_given(f"detection.{name}") for name in TURNS):
        roll, pitch, yaw = survey.turned_deg
        notes.append(
            f"the sensor seems turned by roll {roll:.0f}, pitch {pitch:.0f}, yaw {yaw:.0f} deg against its transform, "
            "or the odometry is mirrored: detections are turned (detection.roll_deg, pitch_deg, yaw_deg); check the "
            "frames"
        )
    if (scale := estimated.get("odometry.turn_scale", 1.0)) != 1.0:
        notes.append(
            f"the odometry's turns seem {100 * abs(1.0 - 1.0 / scale):.0f} % too "
            f"{'small' if scale > 1.0 else 'large'}: corrected (odometry.turn_scale); check its calibration"
        )
    if (scale := estimated.get("odometry.length_scale", 1.0)) != 1.0:
        short, long = ("short", "long") if scale > 1.0 else ("long", "short")
        notes.append(
            f"the odometry's lengths seem {100 * abs(1.0 - 1.0 / scale):.0f} % too {short}: corrected "
            f"(odometry.length_scale); or the ranges of detections are too {long}: then say "
            "--set calibration.odometry.length_scale=1 "
            f"--set calibration.detection.range_scale={1.0 / scale:.3g}"
        )
    elif abs(errors.length_share) > NOTED_SHARE:
        notes.append(
            f"the odometry's lengths seem {100 * abs(errors.length_share):.0f} % too "
            f"{'short' if errors.length_share > 0 else 'long'}, or the ranges of detections too "
            f"{'long' if errors.length_share > 0 else 'short'}: not corrected; check the calibration of both"
        )
    if survey.detour > NOTED_DETOUR:
        notes.append(
            f"the odometry steps back and forth: its path is {survey.detour:.1f} times as long as that of every second "
            f"message; {_about_sources(survey.sources)}"
        )
    if survey.clutter.share > NOTED_FALSE and survey.components is not None:
        notes.append(
            f"{survey.clutter.per_scan:.0f} of {survey.objects:.0f} detections a scan are never seen again: they seem "
            "false; leave out doubtful ones (detection.min_score) or check the detector"
        )
    scan_m = survey.travel_m / survey.scans
    if scan_m * FEW_SCANS > survey.median_range_m:
        notes.append(
            f"only one scan in {scan_m:.1f} m of travel, where objects are {survey.median_range_m:.0f} m away: few "
            "errors average out; record more scans a second"
        )
    if np.isfinite(survey.claimed_ratio) and not 0.25 < survey.claimed_ratio < 4.0:
        notes.append(
            f"detections scatter {np.sqrt(survey.claimed_ratio):.2g} times as much as their covariances say: scaled "
            "(detection.claimed_sigma_factor)"
        )
    if survey.labels.renamed_ns is not None:
        notes.append(
            f"all labels change at {survey.labels.renamed_ns * 1e-9:.3f} s: classes seem to have other names from then "
            "on; labels are ignored (objects.max_classes = 1)"
        )
    elif survey.labels.is_useless:
        notes.append("labels of one object seem drawn at random: they are ignored (objects.max_classes = 1)")
    if survey.components is not None and survey.components.repeated > 1:
        notes.append(
            f"detections repeat their errors over {survey.components.repeated} scans or more: their variance is taken "
            "to be larger by as much"
        )
    if survey.components is None:
        notes.append("too few objects could be tracked to estimate noise: it is taken to be large")
    return tuple(notes)


def _about_sources(sources: int) -> str:
    if sources == 1:
        return "do two sources publish on its topic?"
    return "two sources publish on its topic, and that of the first message is used (odometry.sources)"


def _corrections(survey: Survey, delays: LoggingDelays) -> dict[str, float]:
    errors = survey.errors
    blames_detections = delays.blame_detections(errors.delay_s)
    of_odometry = abs(errors.delay_s) <= STAMPING_SCANS * survey.interval_s
    if blames_detections is not None:
        of_odometry = not blames_detections
    return {
        "odometry.time_offset_s": -errors.delay_s if of_odometry else 0.0,
        "detection.time_offset_s": 0.0 if of_odometry else errors.delay_s,
        "detection.claimed_sigma_factor": _claimed_factor(survey),
        **_detectability(survey),
        **({f"detection.{survey.assumed_frame}": True} if survey.assumed_frame else {}),
        **({"odometry.length_scale": survey.length_scale} if survey.length_scale != 1.0 else {}),
        **({"odometry.turn_scale": survey.turn_scale} if survey.turn_scale != 1.0 else {}),
        **({"odometry.sources": survey.sources} if survey.sources > 1 else {}),
        **_label_settings(survey.labels),
        **{f"detection.{name}": angle for name, angle in zip(TURNS, survey.turned_deg, strict=True) if angle},
    }


def _detectability(survey: Survey) -> dict[str, float]:
    found = survey.detectability
    share: dict[str, float] = {"objects.detection_probability": found.share} if np.isfinite(found.share) else {}
    return share | ({"objects.detection_period": found.period} if found.period > 1 else {})


def _label_settings(labels: LabelNoise) -> dict[str, float]:
    if labels.is_useless:
        return {"objects.max_classes": 1}
    return {"objects.label_accuracy": labels.accuracy} if np.isfinite(labels.accuracy) else {}


def _claimed_factor(survey: Survey) -> float:
    """Factor on the standard deviations that messages claim; 1 where they are about right."""
    if not np.isfinite(survey.claimed_ratio) or 0.25 < survey.claimed_ratio < 4.0:
        return 1.0
    return float(np.sqrt(survey.claimed_ratio))


def _noise(config: Config, survey: Survey) -> dict[str, float]:
    """Standard deviations; of each variance its estimate and one standard error, so that little data make it large."""
    found = _components(survey)
    drift, turn = _shares_not_of_bias(found, survey)
    objects = _objects_that_err_alike(survey, found.view)
    repeated = 1 if survey.components is None else survey.components.repeated
    white, by_range, ratio = _sight_noise(config, survey, found)
    white, by_range = repeated * white, repeated * by_range
    submap_m = SUBMAP_RANGES * _sensor_range_m(config, survey)
    between_passes = found.view + 0.5 * submap_m * found.translation_by_travel
    floor_m = LEAST_SIGMA * survey.range_m
    scan_m = survey.travel_m / survey.scans
    keyframe_m = config.calibrated(_lengths(config, survey)).keyframe_distance_m
    return {
        "odometry.translation_sigma": max(
            np.sqrt(drift * found.translation_by_travel), LEAST_DRIFT * np.sqrt(survey.range_m)
        ),
        "odometry.translation_sigma_by_time": np.sqrt(drift * found.translation_by_time),
        "odometry.yaw_sigma": max(np.sqrt(turn * found.heading_by_travel), LEAST_TURN_RAD / np.sqrt(survey.range_m)),
        "odometry.yaw_sigma_by_turn": np.sqrt(turn * found.heading_by_turn),
        "odometry.yaw_sigma_by_time": np.sqrt(turn * found.heading_by_time),
        "odometry.min_translation_sigma_m": floor_m,
        "detection.base_sigma_m": max(np.sqrt(white), floor_m),
        "detection.sigma_per_m": np.sqrt(by_range),
        "detection.range_sigma_ratio": ratio,
        "detection.common_sigma_m": np.sqrt(found.view),
        "detection.height_sigma_m": _height_sigma(survey, white + by_range * survey.median_range_m**2),
        # Errors stay the same while the viewing direction changes by 1 rad.
        "detection.covariance_inflation": max(objects * survey.median_range_m / max(keyframe_m, scan_m), 1.0),
        "detection.scans_per_view": max(objects * survey.median_range_m / max(scan_m, 1e-9), 1.0),
        "objects.landmark_sigma_m": max(np.sqrt(between_passes), floor_m),
        "objects.landmark_height_sigma_m": np.sqrt(survey.heights.own + 2.0 * survey.heights.common),
    }


def _sight_noise(config: Config, survey: Survey, found: NoiseComponents) -> tuple[float, float, float]:
    """Variance across the line of sight, its growth with the squared range, and the standard deviation along it by that
    across, at the median range. Where the noise is given by hand it is the same along and across.
    """
    if any(config.calibration.is_given(f"detection.{name}") for name in ("base_sigma_m", "sigma_per_m")):
        white, by_range = found.radial + found.tangential, found.radial_by_range + found.tangential_by_range
        return 0.5 * white, 0.5 * by_range, 1.0
    square_m, least = survey.median_range_m**2, (LEAST_SIGMA * survey.range_m) ** 2
    across = max(found.tangential + found.tangential_by_range * square_m, least)
    along = max(found.radial + found.radial_by_range * square_m, least)
    return found.tangential, found.tangential_by_range, min(float(np.sqrt(along / across)), 1.0 / LEAST_SIGMA)


def _height_sigma(survey: Survey, horizontal: float) -> float:
    """Noise of a detection's height beyond the ``horizontal`` variance [m^2].

    It is so large that what all objects in view have in common is not averaged out by them.
    """
    own = max(survey.heights.own - horizontal, 0.0)
    return float(np.sqrt(own + max(survey.objects, 1.0) * survey.heights.common))


def _shares_not_of_bias(found: NoiseComponents, survey: Survey) -> tuple[float, float]:
    """Shares of the odometry's translation and heading variances that a bias of the detections does not explain.

    While the view of the objects changes by 1 rad, over about the median range of travel, a bias b that they share
    looks like an error of the odometry: by b, and by b / range in heading.
    """
    travel_m = survey.median_range_m
    seconds = survey.duration_s / max(survey.travel_m, 1e-9) * travel_m
    turn_rad = survey.turn_rad / max(survey.travel_m, 1e-9) * travel_m
    drift = found.translation_by_travel * travel_m + found.translation_by_time * seconds
    turn = found.heading_by_travel * travel_m + found.heading_by_turn * turn_rad + found.heading_by_time * seconds
    variance = survey.shared_bias_m**2
    return (
        max(1.0 - variance / max(drift, 1e-300), 0.0),
        max(1.0 - variance / travel_m**2 / max(turn, 1e-300), 0.0),
    )


def _objects_that_err_alike(survey: Survey, view: float) -> float:
    """Objects in view that carry the information of one: a bias that centroids share does not average out over them."""
    return 1.0 + survey.objects * survey.shared_bias_m**2 / max(view, 1e-300)


def _components(survey: Survey) -> NoiseComponents:
    estimate = survey.components
    if estimate is None:
        square = survey.range_m**2
        prior = PRIOR_NOISE
        return NoiseComponents(
            radial=prior.radial * square,
            radial_by_range=0.0,
            tangential=prior.tangential * square,
            tangential_by_range=0.0,
            view=prior.view * square,
            jitter=0.0,
            translation_by_travel=prior.translation_by_travel * survey.range_m,
            translation_by_time=0.0,
            heading_jitter=0.0,
            heading_by_travel=prior.heading_by_travel / survey.range_m,
            heading_by_turn=prior.heading_by_turn,
            heading_by_time=0.0,
        )
    found, errors = estimate.variances, estimate.standard_errors
    names = NoiseComponents.__dataclass_fields__
    return NoiseComponents(**{name: getattr(found, name) + getattr(errors, name) for name in names})
