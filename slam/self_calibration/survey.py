"""The survey of a robot's logs: corrections of the input, and noise and lengths of the corrected scans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration, DetectionCalibration
from slam.self_calibration.centroid_bias import centroid_biases, without_bias
from slam.self_calibration.clutter import clutter_density
from slam.self_calibration.corrections import Correction, estimate_corrections
from slam.self_calibration.frames import agree, better_frame, find_orientation, roll_pitch_yaw_deg
from slam.self_calibration.label_noise import LabelNoise, estimate_label_noise
from slam.self_calibration.object_tracks import (
    Detectability,
    ObjectTracks,
    SurveyScan,
    detectability_of,
    follow_objects,
    nearest_of_class_m,
    objects_among,
)
from slam.self_calibration.surveyed_log import SurveyedLog, headings_of, scans_of
from slam.self_calibration.variance_components import ComponentEstimate, Motion, estimate_components

RANGE_QUANTILE = 0.95
MIN_ANGLE_RAD, MIN_SHARE, MAX_SHARE = 0.09, 0.03, 0.5
"""A sensor that is turned by more, and turns of the odometry that are wrong by such a share, are corrected: less may be
the road's, more is no matter of calibration.
"""
MIN_REST = 0.005
"""... and what is then left of turns, as long as it is more than that. So is a climb of the odometry, which explains
little of how objects seem to move but adds up along the way.
"""
FRAMES = "assume_body_frame", "assume_odometry_frame"
"""Settings that take detections to be in another frame than their messages name."""
ANGLES = {"roll_rad": "roll_deg", "pitch_rad": "pitch_deg", "yaw_rad": "yaw_deg"}
SHIFTS = "x_m", "y_m"
"""Terms and settings of where the sensor sits on the body."""
SCALES = {"length_share": "odometry.length_scale", "turn_share": "odometry.turn_scale"}
SETTINGS = (
    SCALES
    | {"climb_share": "odometry.climb"}
    | {name: f"detection.{name}" for name in SHIFTS}
    | {term: f"detection.{name}" for term, name in ANGLES.items()}
)
"""Settings of the terms."""
SAME_HEADING_RAD = 1e-6
"""Headings of an odometry without orientations differ by rounding only."""
ROUNDS = 10
"""Corrections are found one after another, the one that explains most first: a large one is seen in part at first."""


@dataclass(frozen=True, slots=True)
class Survey:
    """The survey of the beginning of a log.

    ``range_m``, ``median_range_m``, ``max_range_m``: the 95th percentile, the median and the maximum of the horizontal
    ranges of detections; ``spacing_m``: the median distance of a detection from the nearest other one of its class in
    the same scan, NaN where classes never share a scan; ``objects``: mean number a scan; ``interval_s``: median time
    between scans; ``claimed_ratio``: the variance of detections by that which their messages claim, NaN where none
    does; ``shared_bias_m``: the rms bias that centroids of a class share; ``components`` is None where too few objects
    could be tracked; ``labels``: how far they can be trusted; ``detectability``: how often an object in view is
    detected; ``clutter_density``: of what belongs to no track of an object [1/m^3].

    ``corrected``: values of the calibration, by their keys, that corrected the scans; ``suspected``: values that would
    predict what is held out better, but are too small or have another explanation; ``delay_s``: by how much
    detections are of a later time than their stamps say, against the odometry; ``lacks_heading``: whether the heading
    of the odometry never changes, and objects do not stand still by it; ``detour``: the length of the odometry's path
    by that of its every second message.
    """

    scans: int
    detections: int
    range_m: float
    median_range_m: float
    max_range_m: float
    spacing_m: float
    objects: float
    interval_s: float
    travel_m: float
    turn_rad: float
    duration_s: float
    claimed_ratio: float
    shared_bias_m: float
    components: ComponentEstimate | None
    detectability: Detectability = field(default_factory=Detectability)
    clutter_density: float = 0.0
    labels: LabelNoise = field(default_factory=LabelNoise)
    corrected: Mapping[str, float] = field(default_factory=dict)
    suspected: Mapping[str, float] = field(default_factory=dict)
    delay_s: float = 0.0
    lacks_heading: bool = False
    detour: float = 1.0


def survey(logs: Sequence[SurveyedLog], given: Calibration | None = None) -> Survey | None:
    """The survey of logs of one robot; None where no detection could be placed on the odometry.

    ``given``: what is known of the calibration; values that were given are neither estimated nor changed.
    """
    given = given or Calibration()
    detour = max((log.detour() for log in logs), default=1.0)
    known = given
    corrected = _frame(logs, known, given)
    labels = _label_noise(logs, known.with_values(corrected))
    if labels.is_useless:
        known = known.with_values({"objects.max_classes": 1})
    if f"detection.{FRAMES[1]}" not in corrected and not given.detection.assume_odometry_frame:
        corrected |= _orientation(logs, known.with_values(corrected), given)
    delay_s = 0.0
    for _ in range(ROUNDS):
        late_s = known.detection.time_offset_s + delay_s
        scans, motion = scans_of(logs, known.with_values(corrected | {"detection.time_offset_s": late_s}))
        tracks = objects_among(follow_objects(scans, motion.headings)) if len(scans) > 1 else None
        found = estimate_corrections(tracks, motion) if tracks is not None else ()
        change = _first_change(found, corrected, known.with_values(corrected), given, scans)
        if not change:
            break
        delay_s += change.pop("delay_s", 0.0)
        corrected |= change
    if not any(np.any(scan.positions) for scan in scans):
        return None
    return replace(
        summarize(scans, tracks),
        labels=labels,
        corrected=corrected,
        suspected=_suspected(found, known.with_values(corrected)),
        delay_s=delay_s,
        lacks_heading=bool(np.ptp(motion.headings) < SAME_HEADING_RAD) and not agree(scans),
        detour=detour,
    )


def _is_large(correction: Correction) -> bool:
    """Whether it is an angle, or a share of lengths or turns, that matters."""
    if correction.term in ANGLES:
        return abs(correction.value) > MIN_ANGLE_RAD
    return correction.term in ("length_share", "turn_share") and abs(correction.value) > MIN_SHARE


def _first_change(
    found: tuple[Correction, ...],
    corrected: Mapping[str, float],
    now: Calibration,
    given: Calibration,
    scans: Sequence[SurveyScan],
) -> dict[str, float]:
    """The values that change by the first of the corrections that is earned, large enough, and not given by hand.

    Ranges of detections that are too long explain the same as lengths of the odometry that are too short. The map
    takes its scale from the ranges, which outnumber the steps, so that the odometry is the one to fit them.
    """
    for each in found:
        key = SETTINGS.get(each.term, "")
        # What is left of a correction is small, and needs to be sure only.
        is_rest = key in corrected and each.is_sure and abs(each.value) > MIN_REST
        is_wanted = is_rest or (each.is_earned and _is_large(each))
        if each.is_earned and each.term == "delay_s":
            return {"delay_s": each.value}
        if each.term in ANGLES and is_wanted and not _is_turned_by_hand(given):
            axis = np.eye(3)[list(ANGLES).index(each.term)]
            return _angles(Rotation.from_rotvec(each.value * axis).as_matrix() @ _turned(now.detection))
        if each.is_earned and each.term in SHIFTS and not given.is_given(key):
            # Where a camera looks ahead only, a bias of its ranges looks like a shift.
            bias_m = sum(abs(other.value) for other in found if other.term == "near_m")
            if abs(each.value) > bias_m:
                shift_m = _value(each, now)
                # No body is so large by what its sensor sees.
                is_possible = abs(shift_m) < MAX_SHARE * np.quantile(_ranges_m(scans), RANGE_QUANTILE)
                return {key: shift_m} if is_possible else {}
        is_climb = each.term == "climb_share" and each.is_sure and each.is_significant
        if is_climb and abs(each.value) > MIN_REST and not given.is_given(key):
            climb = _value(each, now)
            return {key: climb} if abs(climb) < MAX_SHARE else {}
        if each.term in SCALES and is_wanted and not given.is_given(key):
            scale = _value(each, now)
            # Objects that seem to move with the body are in another frame than is believed.
            return {key: scale} if abs(scale - 1.0) < MAX_SHARE else {}
    return {}


def _suspected(found: tuple[Correction, ...], now: Calibration) -> dict[str, float]:
    """What corrections that are earned, but were not made, would change."""
    return {SETTINGS[each.term]: _value(each, now) for each in found if each.is_earned and each.term in SETTINGS}


def _value(each: Correction, now: Calibration) -> float:
    """What the correction changes its setting to."""
    branch, name = SETTINGS[each.term].split(".")
    value = float(getattr(getattr(now, branch), name))
    if each.term in SCALES:
        return value * (1.0 + each.value)
    return value + (float(np.rad2deg(each.value)) if each.term in ANGLES else each.value)


def _is_turned_by_hand(given: Calibration) -> bool:
    return any(given.is_given(f"detection.{name}") for name in ANGLES.values())


def _turned(detection: DetectionCalibration) -> FloatArray:
    angles_deg = [getattr(detection, name) for name in ANGLES.values()]
    return np.asarray(Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix())


def _angles(R: FloatArray) -> dict[str, float]:
    return {
        f"detection.{name}": angle for name, angle in zip(ANGLES.values(), roll_pitch_yaw_deg(R).tolist(), strict=True)
    }


def _frame(logs: Sequence[SurveyedLog], known: Calibration, given: Calibration) -> dict[str, float]:
    """The frame in which scans agree far better than in those that messages name, however turned; empty where they
    agree well or a frame was given by hand.
    """
    if any(given.is_given(f"detection.{name}") for name in FRAMES):
        return {}
    as_they_are, _ = scans_of(logs, known)
    if agree(as_they_are):
        return {}
    others = {name: scans_of(logs, known.with_values({f"detection.{name}": True}))[0] for name in FRAMES}
    turned, _ = scans_of(logs, known.with_values(_orientation(logs, known, given)))
    name = better_frame(turned, others)
    return {} if name is None else {f"detection.{name}": True}


def _orientation(logs: Sequence[SurveyedLog], known: Calibration, given: Calibration) -> dict[str, float]:
    """Angles by which detections must be turned for scans to agree; empty where angles were given by hand."""
    if _is_turned_by_hand(given):
        return {}
    scans, motion = scans_of(logs, known)
    if len(scans) < 2:
        return {}
    R = find_orientation(scans, motion.headings)
    return {} if np.array_equal(R, np.eye(3)) else _angles(R)


def _label_noise(logs: Sequence[SurveyedLog], known: Calibration) -> LabelNoise:
    scans, motion = scans_of(logs, known)
    return estimate_label_noise(scans, motion.headings) if len(scans) > 1 else LabelNoise()


def _ranges_m(scans: Sequence[SurveyScan]) -> FloatArray:
    """Horizontal distances (N,) m of all objects of all scans."""
    return np.concatenate([np.hypot(scan.positions[:, 0], scan.positions[:, 1]) for scan in scans])


def summarize(scans: list[SurveyScan], tracks: ObjectTracks | None = None) -> Survey:
    """The survey of scans (at least one), in the order of their stamps; ``tracks``: of their objects, if known."""
    poses = np.stack([scan.T_odom_body for scan in scans])
    headings = headings_of(scans)
    stamps_s = np.array([(scan.stamp_ns - scans[0].stamp_ns) * 1e-9 for scan in scans])
    motion = Motion(
        np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1))]),
        headings,
        stamps_s,
        poses[:, 2, 3],
    )
    ranges = _ranges_m(scans)
    tracks = tracks or objects_among(follow_objects(scans, headings))
    biases = centroid_biases(tracks)
    median_range_m = float(np.median(ranges))
    components = estimate_components(without_bias(tracks, biases), motion)
    # A detection errs by its own noise and by what changes with the view.
    variance = components.white(median_range_m**2)[0] + components.variances.view if components is not None else 0.0
    return Survey(
        scans=len(scans),
        detections=len(ranges),
        range_m=float(np.quantile(ranges, RANGE_QUANTILE)),
        median_range_m=median_range_m,
        max_range_m=float(ranges.max()),
        spacing_m=_spacing(scans),
        objects=len(ranges) / len(scans),
        interval_s=float(np.median(np.diff(stamps_s))) if len(scans) > 1 else 0.0,
        travel_m=float(motion.travel_m[-1]),
        turn_rad=float(motion.turn_rad[-1]),
        duration_s=float(stamps_s[-1]),
        claimed_ratio=_claimed_ratio(tracks, components),
        shared_bias_m=float(np.sqrt(np.mean(biases[tracks.labels] ** 2))) if len(tracks.labels) else 0.0,
        components=components,
        detectability=detectability_of(tracks),
        clutter_density=clutter_density(scans, len(tracks.track), float(np.sqrt(variance))),
    )


def _spacing(scans: list[SurveyScan]) -> float:
    distances = np.concatenate([nearest_of_class_m(scan.positions[:, :2], scan.labels) for scan in scans])
    distances = distances[np.isfinite(distances)]
    return float(np.median(distances)) if len(distances) else float("nan")


def _claimed_ratio(tracks: ObjectTracks, estimate: ComponentEstimate | None) -> float:
    """Horizontal variance of detections as estimated, by that which their messages claim."""
    claimed = tracks.claimed[np.isfinite(tracks.claimed)]
    if estimate is None or len(claimed) == 0:
        return float("nan")
    square = np.einsum("ni,ni->n", tracks.offsets, tracks.offsets)[np.isfinite(tracks.claimed)]
    return estimate.white(float(np.mean(square)))[0] / float(np.mean(claimed))
