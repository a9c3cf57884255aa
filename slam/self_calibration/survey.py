"""The survey of a robot's logs: corrections of the input, and noise and lengths of the corrected scans."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import Calibration
from slam.common.geometry import apply, gravity_frame, invert, roll_pitch_yaw_deg, rotation_of, travelled_m
from slam.frontend.input.sensor_frames import corrected_mount
from slam.self_calibration.alignment import ANGLES, GROWING, MIN_VALUES, find_alignment
from slam.self_calibration.corrections import (
    Change,
    Correction,
    centroid_biases,
    estimate_corrections,
    find_change,
    regress,
    without_bias,
)
from slam.self_calibration.frames import better_frame, find_level, find_orientation, find_unit, is_unit_right
from slam.self_calibration.object_tracks import (
    ROUNDING,
    Detectability,
    ObjectTracks,
    SurveyScan,
    detectability_of,
    follow_objects,
    headings_of,
    nearest_of_class_m,
    objects_among,
    poses_of,
    ranges_m,
    seconds_of,
)
from slam.self_calibration.resolution import find_resolution
from slam.self_calibration.surveyed_log import SurveyedLog, scans_of
from slam.self_calibration.variance_components import LEAST_PAIRS, ComponentEstimate, Motion, estimate_components

RANGE_QUANTILE = 0.95
MIN_SHARE, MAX_SHARE, MIN_REST = 0.03, 0.5, 0.005
"""Lengths and turns of the odometry that are wrong by more than the first and less than the second share are corrected,
and then what is left of them, as long as it is more than the third: less is no matter, more is none of calibration.
"""
FRAMES = "detection.assume_body_frame", "detection.assume_odometry_frame"
"""Settings that take detections to be in another frame than their messages name."""
ANGLES_DEG = "detection.roll_deg", "detection.pitch_deg", "detection.yaw_deg"
LEVEL_DEG = "odometry.roll_deg", "odometry.pitch_deg"
SHIFTS = {"x_m": "detection.x_m", "y_m": "detection.y_m"}
"""Terms and settings of where the sensor sits on the body."""
SCALES = {"length_share": "odometry.length_scale", "turn_share": "odometry.turn_scale"}
TURNS = {"drift_rad_per_s": "odometry.drift_deg_per_s", "curvature_rad_per_m": "odometry.curvature_deg_per_m"}
OF_ALIGNMENT = {"climb_share": "odometry.climb"} | TURNS
"""Settings of terms of the odometry that are found from pairs of scans, ..."""
SETTINGS = SCALES | TURNS | SHIFTS
"""... and of those that are found from tracks."""
ROUNDS = 10
"""Corrections are found one after another, the one that explains most first: a large one is seen in part at first."""
SLIGHT = 0.2
"""Kappa up to which agreement is slight (Landis and Koch, Biometrics 1977): labels say next to nothing."""
RENAMING = 1e-6
"""Prior probability that classes are renamed within a log."""
FOLLOWED = 0.5
"""Share of the objects in view that must be followed between two scans for their labels to be compared: where the
odometry jumps, positions tell little.
"""


@frozen
class LabelNoise:
    """``accuracy``: the probability that a label is right, NaN where too few objects could be followed or there is one
    class only; ``is_renamed``: whether classes have other names from some scan on.
    """

    accuracy: float = float("nan")
    is_renamed: bool = False

    @property
    def is_useless(self) -> bool:
        """Whether objects are better distinguished without their labels."""
        return self.is_renamed or self.accuracy**2 < SLIGHT


@frozen
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
    detections are of a later time than their stamps say, against the odometry; ``detour``: the length of the odometry's
    path by that of its every second message; ``change``: of a systematic error within the log, ``change_s`` after its
    first scan.
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
    claimed_ratio: float
    shared_bias_m: float
    components: ComponentEstimate | None
    detectability: Detectability
    clutter_density: float
    labels: LabelNoise = field(default_factory=LabelNoise)
    corrected: Mapping[str, float] = field(default_factory=dict)
    suspected: Mapping[str, float] = field(default_factory=dict)
    delay_s: float = 0.0
    detour: float = 1.0
    change: Change | None = None
    change_s: float = 0.0


def survey(logs: Sequence[SurveyedLog], given: Calibration) -> Survey | None:
    """The survey of logs of one robot, one at least; None where no detection could be placed on the odometry.

    ``given``: what is known of the calibration; values that were given are neither estimated nor changed.
    """
    corrected = _level(logs, given)
    if not given.is_given("detection.resolution_m"):
        resolution_m = find_resolution(scans_of(logs, given.with_values(corrected))[0])
        corrected |= {"detection.resolution_m": resolution_m} if resolution_m > 0.0 else {}
    corrected |= _frame(logs, given.with_values(corrected), given)
    known = given.with_values(corrected)
    labels = estimate_label_noise(scans_of(logs, known)[0])
    if labels.is_useless:
        known = known.with_values({"objects.max_classes": 1})
    aligned, unaligned = _alignment(logs, known, _unknown(given))
    delay_s = aligned.pop("delay_s", 0.0)
    corrected |= _of_sensor(aligned, known)
    absent = TURNS.keys() - aligned.keys() if TURNS.keys() & aligned.keys() else ()
    for _ in range(ROUNDS):
        late_s = known.detection.time_offset_s + delay_s
        scans, motion = scans_of(logs, known.with_values(corrected | {"detection.time_offset_s": late_s}))
        tracks = objects_among(follow_objects(scans))
        found = estimate_corrections(tracks, motion, absent)
        change = _first_change(found, corrected, known, given, scans)
        if not change:
            break
        delay_s += change.pop("delay_s", 0.0)
        corrected |= change
    if not any(np.any(scan.positions) for scan in scans):
        return None
    now = known.with_values(corrected)
    later = find_change(tracks, motion)
    suspected = {
        SETTINGS[each.term]: _value(each.term, each.value, now)
        for each in found
        if each.is_earned and each.term in SETTINGS
    }
    return replace(
        summarize(scans, tracks),
        labels=labels,
        corrected=corrected,
        suspected=suspected | {key: value for key, value in _of_sensor(unaligned, now).items() if value},
        delay_s=delay_s,
        detour=max(log.detour() for log in logs),
        change=later,
        change_s=0.0 if later is None else seconds_of(scans)[later.scan],
    )


def _alignment(
    logs: Sequence[SurveyedLog], known: Calibration, terms: Collection[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """Terms of the alignment that followed objects do not contradict, and others that are suspected."""
    aligned, unaligned = find_alignment(logs, known, terms)
    for angle, growing in GROWING.items():
        found = {term: aligned.pop(term) for term in growing if term in aligned}
        if not found:
            continue
        late = {"detection.time_offset_s": known.detection.time_offset_s + aligned.get("delay_s", 0.0)}
        scans, motion = scans_of(logs, known.with_values(late | _of_sensor(aligned, known)))
        tracks = objects_among(follow_objects(scans))
        regression = regress(tracks, motion)
        if regression is None:  # objects do not tell
            aligned |= found
            continue
        best, value = regression.explains_most([*found, angle])
        if best == angle and angle in terms:
            value += aligned.pop(angle, 0.0)
            (aligned if abs(value) > MIN_VALUES[angle] else unaligned)[angle] = value
            continue
        for term, value in found.items():
            (unaligned if regression.is_chance(term, value) else aligned)[term] = value
    return aligned, unaligned


def estimate_label_noise(scans: Sequence[SurveyScan]) -> LabelNoise:
    """Accuracy of the labels in ``scans`` (K), from objects that are tracked by their positions alone.

    Say that a label is right with probability a, else drawn from all labels of the log. Then two sightings of one
    object agree with the probability a^2 + (1 - a^2) c, where c is the probability that two labels drawn at random
    agree: a^2 is Cohen's kappa of successive sightings (Educational and Psychological Measurement, 1960).

    A log may also begin to call all classes by other names: then the labels of all that is in view change between two
    scans.
    """
    tracks = objects_among(follow_objects(scans, by_class=False))
    same = tracks.track[1:] == tracks.track[:-1]
    if int(same.sum()) < LEAST_PAIRS:
        return LabelNoise()
    shares = np.unique(tracks.labels, return_counts=True)[1] / len(tracks.labels)
    by_chance = np.sum(shares**2)
    if by_chance == 1.0:
        return LabelNoise()
    changed = (tracks.labels[1:] != tracks.labels[:-1])[same]
    kappa = 1.0 - np.mean(changed) / (1.0 - by_chance)
    scan = tracks.scan[1:][same]
    followed = np.bincount(scan, minlength=len(scans))
    changes = np.bincount(scan[changed], minlength=len(scans))
    in_view = np.array([len(each.labels) for each in scans])
    is_renamed = _log_likelihood_ratio(followed, changes) > np.log(len(scans) / RENAMING)
    is_renamed &= followed > FOLLOWED * in_view
    # Where none of n pairs differs, one of n + 2 is expected to (Laplace): no label is right for certain.
    accuracy = min(np.sqrt(max(kappa, 0.0)), 1.0 - 1.0 / (len(changed) + 2.0))
    return LabelNoise(accuracy, bool(is_renamed.any()))


def _log_likelihood_ratio(followed: IntArray, changes: IntArray) -> FloatArray:
    """(K,) of new names for all classes against noise, from how many of the followed objects change their labels."""
    # The scan itself is left out of the share of changes that it is compared with.
    share = (changes.sum() - changes + 1.0) / (followed.sum() - followed + 2.0)
    return np.asarray((2.0 * changes - followed) * np.log((1.0 - share) / share))


def _unknown(given: Calibration) -> list[str]:
    """Terms of the alignment that were not given by hand."""
    angles = () if any(map(given.is_given, ANGLES_DEG)) else ANGLES
    return ["delay_s", *angles, *(term for term, key in OF_ALIGNMENT.items() if not given.is_given(key))]


def _of_sensor(found: Mapping[str, float], now: Calibration) -> dict[str, float]:
    """What the angles, the climb and the drift of an alignment change their settings to."""
    rotation = rotation_of(np.array([found.get(angle, 0.0) for angle in ANGLES]))
    mount = corrected_mount(np.eye(4), now.detection)[:3, :3]
    changed = _angles(rotation @ mount) if not found.keys().isdisjoint(ANGLES) else {}
    return changed | {key: _value(term, found[term], now) for term, key in OF_ALIGNMENT.items() if term in found}


def _first_change(
    found: tuple[Correction, ...],
    corrected: Mapping[str, float],
    known: Calibration,
    given: Calibration,
    scans: Sequence[SurveyScan],
) -> dict[str, float]:
    """The values that change by the first of the corrections that is earned, large enough, and not given by hand.

    Ranges of detections that are too long explain the same as lengths of the odometry that are too short. The map
    takes its scale from the ranges, which outnumber the steps, so that the odometry is the one to fit them.
    """
    now = known.with_values(corrected)
    for each in found:
        if each.is_earned and each.term == "delay_s":
            return {"delay_s": each.value}
        key = SETTINGS.get(each.term)
        if key is None or given.is_given(key):
            continue
        value = _value(each.term, each.value, now)
        if each.term in TURNS:
            lacking = each.value_among_all if key in corrected else each.value * each.is_earned
            if lacking:
                return {key: _value(each.term, lacking, now)}
        elif each.term in SHIFTS and each.is_earned:
            # Where a camera looks ahead only, a bias of its ranges looks like a shift.
            bias_m = sum(abs(other.value) for other in found if other.term == "near_m")
            if abs(each.value) > bias_m:
                # No body is so large by what its sensor sees.
                is_possible = abs(value) < MAX_SHARE * np.quantile(ranges_m(scans), RANGE_QUANTILE)
                return {key: value} if is_possible else {}
        elif each.term in SCALES:
            # What is left of a correction is small, and needs to be sure only.
            is_rest = key in corrected and each.is_sure and abs(each.value) > MIN_REST
            if is_rest or (each.is_earned and abs(each.value) > MIN_SHARE):
                # Objects that seem to move with the body are in another frame than is believed.
                return {key: value} if abs(value / known.value_of(key) - 1.0) < MAX_SHARE else {}
    return {}


def _value(term: str, change: float, now: Calibration) -> float:
    """What a change by a term makes of its setting."""
    value = now.value_of((SETTINGS | OF_ALIGNMENT)[term])
    if term in SCALES:
        return value * (1.0 + change)
    return float(value + (np.rad2deg(change) if term in TURNS else change))


def _angles(R: FloatArray) -> dict[str, float]:
    return dict(zip(ANGLES_DEG, roll_pitch_yaw_deg(R).tolist(), strict=True))


def _level(logs: Sequence[SurveyedLog], given: Calibration) -> dict[str, float]:
    """The rotation of the odometry frame, if it is not level; empty where it was given by hand."""
    if any(map(given.is_given, LEVEL_DEG)):
        return {}
    R = find_level(np.concatenate([log.rotations() for log in logs]))
    return {} if np.array_equal(R, np.eye(3)) else dict(zip(LEVEL_DEG, roll_pitch_yaw_deg(R)[:2].tolist(), strict=True))


def _frame(logs: Sequence[SurveyedLog], known: Calibration, given: Calibration) -> dict[str, float]:
    """The frame, the axes and the unit of the odometry in which objects stand still, as far as they are not those that
    messages name; what was given by hand is kept.
    """
    scans, _ = scans_of(logs, known)
    if len(scans) < 2:
        return {}
    orientation = _orientation(scans, known, given)
    as_they_are = scans_of(logs, known.with_values(orientation))[0] if orientation else scans
    may_have_a_unit = known.odometry.length_scale == 1.0 and not given.is_given("odometry.length_scale")
    if may_have_a_unit and not is_unit_right(as_they_are) and (factor := find_unit(scans)) != 1.0:
        unit = {"odometry.length_scale": factor}
        return unit | _frame(logs, known.with_values(unit), given)
    if any(map(given.is_given, FRAMES)):
        return orientation
    others = {key: scans_of(logs, known.with_values({key: True}))[0] for key in FRAMES}
    key = better_frame(as_they_are, others)
    if key is None:
        return orientation
    # Objects stand still in the odometry frame whatever the axes of the body are.
    return {key: True} | ({} if key == FRAMES[1] else _orientation(others[key], known, given))


def _orientation(scans: Sequence[SurveyScan], known: Calibration, given: Calibration) -> dict[str, float]:
    """Angles by which detections must be turned for objects to stand still; empty where angles were given by hand."""
    if any(map(given.is_given, ANGLES_DEG)) or known.detection.assume_odometry_frame:
        return {}
    R = find_orientation(scans)
    return {} if np.array_equal(R, np.eye(3)) else _angles(R)


def summarize(scans: Sequence[SurveyScan], tracks: ObjectTracks) -> Survey:
    """The survey of scans (at least one), in the order of their stamps, by the ``tracks`` of their objects."""
    poses = poses_of(scans)
    stamps_s = seconds_of(scans)
    motion = Motion(travelled_m(poses[:, :2, 3]), headings_of(scans), stamps_s, poses[:, 2, 3])
    ranges = ranges_m(scans)
    biases = centroid_biases(tracks)
    median_range_m = np.median(ranges)
    distances = nearest_of_class_m(scans, is_level=True)
    distances = distances[np.isfinite(distances)]
    components = _components(scans, without_bias(tracks, biases), motion)
    # A detection errs by its own noise and by what changes with the view.
    variance = components.white(median_range_m**2) + components.variances.view if components is not None else 0.0
    return Survey(
        scans=len(scans),
        detections=len(ranges),
        range_m=np.quantile(ranges, RANGE_QUANTILE),
        median_range_m=median_range_m,
        max_range_m=ranges.max(),
        spacing_m=np.median(distances) if len(distances) else float("nan"),
        objects=len(ranges) / len(scans),
        interval_s=np.median(np.diff(stamps_s)) if len(scans) > 1 else 0.0,
        travel_m=motion.travel_m[-1],
        claimed_ratio=_claimed_ratio(tracks, components),
        shared_bias_m=np.sqrt(np.mean(biases[tracks.labels] ** 2)) if len(tracks.labels) else 0.0,
        components=components,
        detectability=detectability_of(tracks),
        clutter_density=clutter_density(scans, len(tracks.track), np.sqrt(variance)),
    )


def _components(scans: Sequence[SurveyScan], tracks: ObjectTracks, motion: Motion) -> ComponentEstimate | None:
    """The noise of odometry and detections. Where a body leans whose sensor measures no heights, those of all objects
    seem to change: that is noise of heights, and tells nothing else.
    """
    T_odom_body = poses_of(scans)
    T_body_gravity = invert(T_odom_body) @ gravity_frame(T_odom_body)
    points = np.concatenate([apply(T, scan.positions) for T, scan in zip(T_body_gravity, scans, strict=True)])
    ranges = np.linalg.norm(points, axis=1)
    squares = np.linalg.eigvalsh(np.cov(points[ranges <= np.median(ranges)].T, bias=True))
    # All detections of such a sensor lie in one plane of the body; the nearer half has no absurd ones.
    is_planar = squares[0] <= ROUNDING * squares[-1]
    if not is_planar:
        return estimate_components(tracks, motion)
    estimate = estimate_components(replace(tracks, heights=np.zeros_like(tracks.heights)), motion)
    if estimate is None:
        return None
    _, row = np.unique(tracks.track, return_inverse=True)
    means = np.bincount(row, tracks.heights) / np.bincount(row)
    # The median of chi-squared with one degree of freedom is 0.455.
    rise = np.median((tracks.heights - means[row]) ** 2) / 0.455
    return replace(estimate, variances=replace(estimate.variances, rise=rise))


def _claimed_ratio(tracks: ObjectTracks, estimate: ComponentEstimate | None) -> float:
    """Horizontal variance of detections as estimated, by that which their messages claim."""
    is_claimed = np.isfinite(tracks.claimed)
    if estimate is None or not is_claimed.any():
        return float("nan")
    squares = np.einsum("ni,ni->n", tracks.offsets, tracks.offsets)[is_claimed]
    return estimate.white(float(np.mean(squares))) / float(np.mean(tracks.claimed[is_claimed]))


def clutter_density(scans: Sequence[SurveyScan], tracked: int, sigma_m: float) -> float:
    """Density [1/m^3], as association sees it, of the detections of scans (one at least) that are of no object: all but
    so many that are ``tracked``, with noise ``sigma_m``.

    Where points lie at random with a density d, the nearest one is farther than r with the probability
    exp(-pi d r^2), for any field of view; half of them are farther than the median.
    """
    heights = np.concatenate([scan.positions[:, 2] for scan in scans])
    median_m = np.median(nearest_of_class_m([replace(scan, labels=0 * scan.labels) for scan in scans], is_level=True))
    share = 1.0 - tracked / len(heights)
    # The width of an even distribution with the entropy of a Gaussian; a detection and a landmark both err.
    height_m = np.sqrt(2.0 * np.pi * np.e * (np.var(heights) + 2.0 * sigma_m**2))
    area_m2 = np.pi * median_m**2 / np.log(2.0)
    is_known = 0.0 < median_m < np.inf and height_m > 0.0
    return float(share / (area_m2 * height_m)) if is_known else 0.0
