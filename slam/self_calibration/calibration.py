"""The calibration of a robot from the survey of its logs.

Values that were given by hand are kept. Where the logs tell too little, the noise is taken to be large: a prior in
units of the sensor range, not that of a good sensor.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, astuple, field

import numpy as np

from logs.records import frozen
from slam.common.calibration import Calibration, DetectionCalibration, ObjectCalibration, OdometryCalibration
from slam.common.config import SUBMAP_RANGES, Config
from slam.common.errors import InputDataError
from slam.frontend.input.stamp_clocks import LoggingDelays
from slam.self_calibration.survey import Survey
from slam.self_calibration.surveyed_log import MAX_DETOUR
from slam.self_calibration.variance_components import LENGTH_POWERS, NoiseComponents

PRIOR_NOISE = NoiseComponents(
    radial=0.02**2,
    tangential=0.02**2,
    view=0.02**2,
    view_height=0.02**2,
    translation_by_travel=0.05**2,
    heading_by_travel=0.2**2,
    heading_by_turn=0.1**2,
    tilt_by_travel=0.002**2,
)
"""Variances where a log tells nothing, lengths in sensor ranges: detections are off by 2 % of the range, the odometry
by 5 % of it, and by 11 deg, after as much travel, and by 6 deg after turning by 1 rad.
"""
MIN_DRIFT, MIN_TURN_RAD = 0.01, 0.005
"""Detections cannot tell an odometry better than that: off by such a share of the sensor range after as much travel,
and by so many radians. An estimate of zero means that the noise is too small to be observed.
"""
CERTAIN = 2.0
"""Standard errors by which a noise is larger, with a probability of 98 %."""
MIN_SIGMA = 1e-4
"""Least noise of a position, in sensor ranges."""
UNIQUE_SPACING = 1e3
"""Distance, in sensor ranges, between objects of a class of which no two share a scan."""
STAMPING_SCANS = 2.0
"""Where log times do not tell whose stamps are wrong: up to so many intervals between scans, a difference in time
between odometry and detections is a matter of how the odometry is stamped (of a step, its begin or its end), and the
odometry is moved; beyond that, detections were old when they were stamped.
"""
CLAIMED_FACTOR = 4.0
"""Variances that messages claim are right within that factor."""
NO_DELAYS = LoggingDelays()
DEFAULT_RANGE_M = DetectionCalibration().sensor_range_m
MAX_SCALE = 1e30
"""Lengths so many times the usual ones, or a part of them as small, are beyond float64 in their powers."""
_MEANINGS = {
    "odometry.time_offset_s": "odometry messages are {:+.3f} s off their stamps",
    "detection.time_offset_s": "detections are {:+.3f} s off their stamps",
    "odometry.length_scale": "the lengths of the odometry need a factor of {:.3f}, if the ranges of detections are "
    "right (else give calibration.detection.range_scale)",
    "odometry.turn_scale": "the rotations of the odometry need a factor of {:.3f}",
    "odometry.roll_deg": "the frame of the odometry is not level: turned by a roll of {:z.1f} deg",
    "odometry.pitch_deg": "the frame of the odometry is not level: turned by a pitch of {:z.1f} deg",
    "odometry.climb": "the odometry lacks a climb of {:+.3f} of its path",
    "odometry.drift_deg_per_s": "the odometry lacks a turn of {:+.3f} deg/s, as by the bias of a gyroscope",
    "odometry.curvature_deg_per_m": "the odometry lacks a turn of {:+.3f} deg/m, as by wheels of unequal diameter",
    "detection.roll_deg": "the sensor has a roll of {:z.1f} deg relative to its transform: check the frames",
    "detection.pitch_deg": "the sensor has a pitch of {:z.1f} deg relative to its transform: check the frames",
    "detection.yaw_deg": "the sensor has a yaw of {:z.1f} deg relative to its transform: check the frames",
    "detection.x_m": "the sensor is {:.2f} m farther ahead than its transform says: check the frames",
    "detection.y_m": "the sensor is {:.2f} m farther to the left than its transform says: check the frames",
    "detection.assume_body_frame": "detections are in the frame of the body, not in the one that they name",
    "detection.assume_odometry_frame": "detections are in the frame of the odometry, not in the one that they name",
    "detection.resolution_m": "objects are detected several times in a scan, up to {:.2f} m apart: the best is used",
    "detection.claimed_sigma_factor": "detections scatter {:.2g} times as much as their covariances say",
    "objects.max_classes": "labels of one object change at random, or all at once: they are ignored",
}
"""What a correction says, for people."""
_CHANGES = {
    "delay_s": "detections become later by {0:+.3f} s",
    "roll_rad": "the sensor turns by a roll of {1:+.1f} deg",
    "pitch_rad": "the sensor turns by a pitch of {1:+.1f} deg",
    "yaw_rad": "the sensor turns by a yaw of {1:+.1f} deg",
    "length_share": "the lengths of the odometry, by the ranges of detections, need another {0:+.1%}",
    "turn_share": "the rotations of the odometry need another {0:+.1%}",
    "drift_rad_per_s": "the odometry lacks another turn of {1:+.3f} deg/s",
    "curvature_rad_per_m": "the odometry lacks another turn of {1:+.3f} deg/m",
    "climb_share": "the odometry lacks another climb of {0:+.3f} of its path",
    "x_m": "the sensor moves ahead by {0:+.2f} m",
    "y_m": "the sensor moves to the left by {0:+.2f} m",
    "near_m": "ranges of detections need another {0:+.2f} m",
    "low_share": "detections need another height of {0:+.3f} of their range",
}
"""What a change within the log says: of its value, and of that in degrees."""


@frozen
class CalibratedLog:
    """``config``: the effective configuration; ``estimated``: the values of the calibration, by their keys, that the
    log decided; ``notes``: its corrections and faults, for people.
    """

    config: Config
    estimated: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def calibrate(config: Config, survey: Survey | None, delays: LoggingDelays = NO_DELAYS) -> CalibratedLog:
    """The configuration for a log: what was not given of its calibration is derived from its survey.

    ``delays``: how long after their stamps messages were logged, which tells whose stamps are wrong.
    """
    if survey is None:
        return CalibratedLog(
            config, notes=("no detection could be placed on the odometry: nothing was estimated from the log",)
        )
    corrections = _corrections(survey, delays)
    lengths = _lengths(config, survey)
    noise = _noise(config.calibrated(lengths), survey)
    values = lengths | noise | _objects(survey) | corrections
    estimated = {key: value for key, value in values.items() if not config.calibration.is_given(key)}
    evidence = {
        "scans": survey.scans,
        "detections": survey.detections,
        "travel_m": survey.travel_m,
        "pairs": 0 if survey.components is None else survey.components.pairs,
    }
    calibration = config.calibrated(estimated).calibration.model_copy(
        update={"sigmas": _sigmas(survey, estimated), "evidence": evidence}
    )
    return CalibratedLog(
        config.model_copy(update={"calibration": calibration}),
        estimated,
        tuple(_notes(survey, {key: value for key, value in corrections.items() if key in estimated})),
    )


def _corrections(survey: Survey, delays: LoggingDelays) -> dict[str, float]:
    values = {"odometry.time_offset_s": 0.0, "detection.time_offset_s": 0.0, **survey.corrected}
    blames_detections = delays.blame_detections(survey.delay_s)
    if blames_detections is None:
        blames_detections = abs(survey.delay_s) > STAMPING_SCANS * survey.interval_s
    if blames_detections:
        values["detection.time_offset_s"] = survey.delay_s
    else:
        values["odometry.time_offset_s"] = -survey.delay_s
    if not 1.0 / CLAIMED_FACTOR < survey.claimed_ratio < CLAIMED_FACTOR and np.isfinite(survey.claimed_ratio):
        values["detection.claimed_sigma_factor"] = np.sqrt(survey.claimed_ratio)
    if survey.labels.is_useless:
        values["objects.max_classes"] = 1
    return values


def _lengths(config: Config, survey: Survey) -> dict[str, float]:
    is_given = config.calibration.is_given("detection.sensor_range_m")
    range_m = config.sensor_range_m if is_given else survey.range_m
    scale = range_m / DEFAULT_RANGE_M
    if not 1.0 / MAX_SCALE < scale < MAX_SCALE:
        raise InputDataError(f"objects are seen at {survey.range_m:.3g} m; give their positions in metres")
    # Too few tracks do not tell false detections from others.
    false = survey.clutter_density if survey.components is not None else 0.0
    return {
        "detection.sensor_range_m": range_m,
        "detection.farthest_m": survey.max_range_m,
        "objects.new_object_density": max(ObjectCalibration().new_object_density * scale**-3, false),
        "objects.spacing_m": survey.spacing_m if np.isfinite(survey.spacing_m) else UNIQUE_SPACING * range_m,
    }


def _objects(survey: Survey) -> dict[str, float]:
    found, labels = survey.detectability, survey.labels
    values = {}
    if np.isfinite(found.share):
        values = {"objects.detection_probability": found.share, "objects.detection_period": found.period}
    if np.isfinite(labels.accuracy) and not labels.is_useless:
        values["objects.label_accuracy"] = labels.accuracy
    return values


def _noise(config: Config, survey: Survey) -> dict[str, float]:
    """Standard deviations; of each variance its estimate and one standard error, so that little data make it large.

    ``config``: with the lengths that were estimated.
    """
    found = _components(survey)
    # Objects in view that carry the information of one: a bias that centroids share does not average out over them.
    objects = 1.0 + survey.objects * survey.shared_bias_m**2 / max(found.view, 1e-300)
    between_passes = found.view + 0.5 * SUBMAP_RANGES * config.sensor_range_m * found.translation_by_travel
    scan_m = survey.travel_m / survey.scans
    # What heights have in common is put down to the detector, because gravity and the ground hold the odometry.
    rise = found.rise + found.rise_by_travel * survey.median_range_m
    # The least noise that is believed of any robot.
    least_m, root, square_m = MIN_SIGMA * survey.range_m, np.sqrt(survey.range_m), survey.median_range_m**2
    across = found.tangential + found.tangential_by_range * square_m
    along = found.radial + found.radial_by_range * square_m
    height = max(found.height - across, 0.0)
    return {
        "odometry.translation_sigma": max(np.sqrt(found.translation_by_travel), MIN_DRIFT * root),
        "odometry.translation_sigma_by_time": np.sqrt(found.translation_by_time),
        "odometry.yaw_sigma": max(np.sqrt(found.heading_by_travel), MIN_TURN_RAD / root),
        "odometry.min_translation_sigma_m": least_m,
        "odometry.tilt_sigma": _tilt_sigma(survey),
        "odometry.yaw_sigma_by_turn": np.sqrt(found.heading_by_turn),
        "odometry.yaw_sigma_by_time": np.sqrt(found.heading_by_time),
        "detection.base_sigma_m": max(np.sqrt(found.tangential), least_m),
        "detection.sigma_per_m": np.sqrt(found.tangential_by_range),
        "detection.range_sigma_ratio": min(np.sqrt(max(along, least_m**2) / max(across, least_m**2)), 1.0 / MIN_SIGMA),
        "detection.common_sigma_m": np.sqrt(found.view),
        # So large that what all objects in view have in common is not averaged out by them.
        "detection.height_sigma_m": np.sqrt(height + max(survey.objects, 1.0) * rise),
        "detection.common_height_sigma_m": np.sqrt(found.view_height),
        "detection.stamp_sigma_s": np.sqrt(found.stamps),
        # Errors stay the same while the view changes by 1 rad.
        "detection.covariance_inflation": max(
            objects * survey.median_range_m / max(config.keyframe_distance_m, scan_m), 1.0
        ),
        "objects.landmark_sigma_m": max(np.sqrt(between_passes), least_m),
        "objects.landmark_height_sigma_m": np.sqrt(height + found.view_height + 2.0 * rise),
    }


def _tilt_sigma(survey: Survey) -> float:
    """Noise of roll and pitch by travel: that of an odometry whose tilt gravity holds, unless the log contradicts it.

    Heights of detections that err by the view look like a tilt, and no odometry knows its tilt worse than its heading:
    what both show for certain is noise of the tilt.
    """
    usual, estimate = OdometryCalibration().tilt_sigma, survey.components
    if estimate is None:
        return usual
    found, errors = estimate.variances, estimate.standard_errors
    certain = min(
        found.tilt_by_travel - CERTAIN * errors.tilt_by_travel,
        found.heading_by_travel - CERTAIN * errors.heading_by_travel,
        np.pi**2 / survey.range_m,
    )
    return float(np.sqrt(max(certain, usual**2)))


def _components(survey: Survey) -> NoiseComponents:
    estimate = survey.components
    if estimate is None:
        return NoiseComponents(*np.multiply(astuple(PRIOR_NOISE), survey.range_m**LENGTH_POWERS).tolist())
    # An odometry tells nothing that errs by the range after as much travel, or by half a turn after that, after turning
    # by 1 rad, or within 1 s. Where the body stands, travel explains anything. Stamps are in the order of the scans.
    half_turn = np.pi**2
    most = {
        "translation_by_travel": survey.range_m,
        "heading_by_travel": half_turn / survey.range_m,
        "heading_by_turn": half_turn,
        "heading_by_time": half_turn,
        "stamps": survey.interval_s**2,
    }
    errors = asdict(estimate.standard_errors)
    found = asdict(estimate.variances).items()
    return NoiseComponents(**{name: min(value + errors[name], most.get(name, np.inf)) for name, value in found})


def _sigmas(survey: Survey, estimated: Mapping[str, float]) -> dict[str, float]:
    """Standard errors of noise: of a square root, half that of its square by its value."""
    names = {
        "odometry.translation_sigma": "translation_by_travel",
        "odometry.yaw_sigma": "heading_by_travel",
        "odometry.yaw_sigma_by_turn": "heading_by_turn",
        "detection.base_sigma_m": "tangential",
        "detection.common_sigma_m": "view",
    }
    if survey.components is None:
        return {}
    errors = survey.components.standard_errors
    return {
        key: float(0.5 * getattr(errors, name) / estimated[key])
        for key, name in names.items()
        if estimated.get(key, 0.0) > 0.0
    }


def _notes(survey: Survey, corrections: Mapping[str, float]) -> Iterator[str]:
    """Notes for the user on the faults of the log, corrected or not."""
    for key, meaning in _MEANINGS.items():
        if corrections.get(key, usual := Calibration().value_of(key)) != usual:
            yield f"{meaning.format(corrections[key])}: corrected ({key})"
        elif (suspected := meaning.format(survey.suspected.get(key, usual))) != meaning.format(usual):
            yield f"{suspected}: suspected, not corrected ({key})"
    if survey.change is not None:
        value = survey.change.value
        yield (
            f"about {survey.change_s:.0f} s after the first scan, "
            f"{_CHANGES[survey.change.term].format(value, np.rad2deg(value))}: not corrected; cut the log there, and "
            "replay the second part with the map of the first (--map)"
        )
    if survey.detour > MAX_DETOUR:
        yield (
            f"the odometry steps back and forth: its path is {survey.detour:.1f} times as long as that of every second "
            "message; do two sources publish on its topic?"
        )
    if survey.components is None:
        yield "too few objects could be tracked to estimate noise: a large noise is assumed"
