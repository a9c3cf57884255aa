"""The survey of a log: one pass over its beginning, from which noise and scales are estimated before it is mapped."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from logs.messages import ObjectDetections, Odometry, Record, Transform
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import DetectionCalibration, ObjectCalibration
from slam.common.geometry import apply, interpolate, invert, transform_from_xyz_yaw, yaw_rad
from slam.frontend.input.scan import is_wanted
from slam.frontend.input.sensor_frames import SensorFrames, find_sensor
from slam.odometry.scaled_odometry import ScaledOdometry
from slam.odometry.sources import FollowedSource
from slam.self_calibration.centroid_bias import centroid_biases, without_bias
from slam.self_calibration.clutter import Clutter, measure_clutter
from slam.self_calibration.detection_frame import agree, better_frame
from slam.self_calibration.height_noise import HeightNoise, estimate_height_noise
from slam.self_calibration.input_errors import BodyMotion, InputErrors, estimate_input_errors
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
from slam.self_calibration.sensor_orientation import find_orientation, roll_pitch_yaw_deg
from slam.self_calibration.variance_components import CLIP, ComponentEstimate, Motion, estimate_components

MAX_DETECTIONS = 150_000
"""The survey ends after that many detections; what it estimates has converged by then."""
MAX_CLASSES = int(ObjectCalibration.model_fields["max_classes"].get_default())
RANGE_QUANTILE = 0.95
FAR_OFF = 100.0
"""Detections beyond so many median ranges are no measurements."""
NOTED_YAW_RAD = 0.09
"""A sensor that is turned by more than that against its transform is corrected; less may be the road's."""
SAME_VIEW_RAD = 0.05
"""Change of the viewing direction within which scans may repeat the errors of one another: what errs by the view is a
variance component of its own.
"""
NOTED_SHARE, MOST_SHARE = 0.03, 0.5
"""Lengths and turns of the odometry that are wrong by such a share are corrected; more is no matter of calibration."""
LEAST_SHARE = 0.005
"""... and what is then left of them, as long as it is more than that."""
MOST_REPEATED = 16
NOTED_DETOUR = 1.5
"""Poses of one source hardly ever go back with every other message."""
FRAMES = "assume_body_frame", "assume_odometry_frame"
"""Settings that take detections to be in another frame than their messages name."""
SAME_HEADING_RAD = 1e-6
"""Headings of an odometry without orientations differ by rounding only."""
ROUNDS = 8
"""Corrections of the input are found one after another: a large one is only seen in part at first."""


@dataclass(frozen=True, slots=True)
class Survey:
    """What the beginning of a log tells.

    ``range_m``, ``median_range_m``, ``max_range_m``: the 95th percentile, the median and the maximum of the horizontal
    ranges of detections; ``spacing_m``: the median distance of a detection from the nearest other one of its class in
    the same scan, NaN where classes never share a scan; ``objects``: mean number a scan; ``interval_s``: median time
    between scans; ``claimed_ratio``: the variance of detections by that which their messages claim, NaN where none
    does; ``shared_bias_m``: the rms bias that centroids of a class share; ``components`` is None where too few objects
    could be tracked; ``labels``: how far they can be trusted; ``heights``: how much the heights of detections vary;
    ``lacks_heading``: whether that of the odometry never changes, and objects do not stand still by it;
    ``assumed_frame``: the setting by which detections are taken to be in another frame than their messages name;
    ``turned_deg``: roll, pitch and yaw by which detections had to be turned beyond the transform of their sensor;
    ``length_scale``, ``turn_scale``: factors by which the odometry's lengths and turns had to be corrected;
    ``detectability``: how often an object in view is detected; ``clutter``: what belongs to no track of an object;
    ``detour``: the length of the odometry's path by that of its every second message; ``sources``: how many of them
    there are, two where one that is told apart from the other makes no detour.
    """

    scans: int
    detections: int
    classes: int
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
    errors: InputErrors
    labels: LabelNoise = field(default_factory=LabelNoise)
    heights: HeightNoise = field(default_factory=HeightNoise)
    lacks_heading: bool = False
    assumed_frame: str | None = None
    turned_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    detour: float = 1.0
    sources: int = 1
    detectability: Detectability = field(default_factory=Detectability)
    clutter: Clutter = field(default_factory=Clutter)
    length_scale: float = 1.0
    turn_scale: float = 1.0


def survey(
    records: Iterable[Record],
    config: DetectionCalibration,
    frames: SensorFrames | None = None,
    *,
    max_classes: int = MAX_CLASSES,
    given: Collection[str] = (),
) -> Survey | None:
    """The survey of the records of a log, in its order; None where no detection could be placed on the odometry.

    ``frames``: where the sensors sit, as far as it is known already; transforms among the records add to it.
    ``max_classes``: all labels beyond so many are one, as they are in the map. ``given``: settings of the odometry that
    were set by hand; a ``length_scale`` and a ``turn_scale`` among them are kept.
    """
    gathered = _Gathered(frames or SensorFrames(), max_classes)
    for record in records:
        if gathered.add(record) >= MAX_DETECTIONS:
            break
    detour = gathered.detour()
    sources = 2 if detour > NOTED_DETOUR and gathered.follow_one_source() else 1
    is_yaw_given = "yaw_deg" in config.model_fields_set
    assumed = _assumed_frame(gathered, config)
    if assumed is not None:
        config = config.model_copy(update={assumed: True})
    labels = gathered.judge_labels(config)
    if not config.assume_odometry_frame:
        config = _oriented(gathered, config)
    errors = InputErrors()
    for _ in range(ROUNDS):
        scans = gathered.scans(config, errors.delay_s)
        if len(scans) < 2:
            break
        found = estimate_input_errors(gathered.tracks(scans), gathered.motion(scans, errors.delay_s))
        errors = replace(found, delay_s=errors.delay_s + found.delay_s)
        is_turned = abs(found.yaw_rad) > NOTED_YAW_RAD and not is_yaw_given
        if is_turned:
            config = config.model_copy(update={"yaw_deg": config.yaw_deg + float(np.rad2deg(found.yaw_rad))})
        is_scaled = gathered.scale_odometry(found, given)
        if found.delay_s == 0.0 and not is_turned and not is_scaled:
            break
    scans = gathered.scans(config, errors.delay_s)
    if not any(np.any(scan.positions) for scan in scans):
        return None
    turned_deg = (config.roll_deg, config.pitch_deg, (config.yaw_deg + 180.0) % 360.0 - 180.0)
    told = summarize(scans, errors, gathered.tracks(scans))
    lacks_heading = bool(np.ptp(_headings(scans)) < SAME_HEADING_RAD) and not agree(scans)
    length_scale, turn_scale = gathered.scales
    return replace(
        told,
        lacks_heading=lacks_heading,
        assumed_frame=assumed,
        turned_deg=turned_deg,
        labels=labels,
        detour=detour,
        sources=sources,
        length_scale=length_scale,
        turn_scale=turn_scale,
    )


def _assumed_frame(gathered: _Gathered, config: DetectionCalibration) -> str | None:
    """The setting by which scans agree far better than by the frames that messages name, however turned; None where
    they agree well or a setting was given by hand.
    """
    if config.model_fields_set & set(FRAMES):
        return None
    as_they_are = gathered.scans(config, 0.0)
    if agree(as_they_are):
        return None
    others = {name: gathered.scans(config.model_copy(update={name: True}), 0.0) for name in FRAMES}
    if better_frame(as_they_are, others) is None:
        return None
    return better_frame(gathered.scans(_oriented(gathered, config), 0.0), others)


def _oriented(gathered: _Gathered, config: DetectionCalibration) -> DetectionCalibration:
    """The configuration with detections turned so that scans agree; as it is where angles were given by hand."""
    if config.model_fields_set & {"roll_deg", "pitch_deg", "yaw_deg"}:
        return config
    scans = gathered.scans(config, 0.0)
    if len(scans) < 2:
        return config
    roll, pitch, yaw = roll_pitch_yaw_deg(find_orientation(scans, _headings(scans))).tolist()
    return config.model_copy(update={"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw})


def summarize(scans: list[SurveyScan], errors: InputErrors | None = None, tracks: ObjectTracks | None = None) -> Survey:
    """What scans (one at least), in the order of their stamps and corrected by ``errors``, tell; ``tracks``: those of
    their objects, where they are known already.
    """
    poses = np.stack([scan.T_odom_body for scan in scans])
    headings = _headings(scans)
    stamps_s = np.array([(scan.stamp_ns - scans[0].stamp_ns) * 1e-9 for scan in scans])
    motion = Motion(
        np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1))]),
        np.concatenate([[0.0], np.cumsum(np.abs(np.diff(headings)))]),
        stamps_s,
    )
    ranges = np.concatenate([np.hypot(scan.positions[:, 0], scan.positions[:, 1]) for scan in scans])
    tracks = tracks or objects_among(follow_objects(scans, headings))
    biases = centroid_biases(tracks)
    components = estimate_components(
        without_bias(tracks, biases), motion, most_repeated=_scans_of_a_view(float(np.median(ranges)), motion)
    )
    median_range_m = float(np.median(ranges))
    # A detection errs by its own noise and by what changes with the view.
    variance = components.white(median_range_m**2)[0] + components.variances.view if components is not None else 0.0
    return Survey(
        scans=len(scans),
        detections=len(ranges),
        classes=len(np.unique(np.concatenate([scan.labels for scan in scans]))),
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
        errors=errors or InputErrors(),
        heights=estimate_height_noise(tracks),
        detectability=detectability_of(tracks),
        clutter=measure_clutter(scans, len(tracks.track), float(np.sqrt(variance))),
    )


def _path_length(poses: FloatArray) -> float:
    """Length [m] of the path through poses (K, 4, 4); single messages that are far off add little."""
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    moved = steps_m > 0.0
    return float(np.minimum(steps_m, CLIP * np.median(steps_m[moved])).sum()) if moved.any() else 0.0


def _headings(scans: list[SurveyScan]) -> FloatArray:
    """Headings (K,) rad of the body at scans, without jumps by whole turns."""
    return np.unwrap(yaw_rad(np.stack([scan.T_odom_body for scan in scans])))


def _without_far_off(scans: list[SurveyScan]) -> list[SurveyScan]:
    """The scans without detections so far away that they are no measurements."""
    if not scans:
        return scans
    limit_m = FAR_OFF * float(np.median(np.concatenate([_ranges(scan) for scan in scans])))
    near = [_ranges(scan) <= limit_m for scan in scans]
    return [
        replace(scan, positions=scan.positions[kept], labels=scan.labels[kept], variances=scan.variances[kept])
        for scan, kept in zip(scans, near, strict=True)
        if kept.any()
    ]


def _ranges(scan: SurveyScan) -> FloatArray:
    return np.hypot(scan.positions[:, 0], scan.positions[:, 1])


def _spacing(scans: list[SurveyScan]) -> float:
    distances = np.concatenate([nearest_of_class_m(scan.positions[:, :2], scan.labels) for scan in scans])
    distances = distances[np.isfinite(distances)]
    return float(np.median(distances)) if len(distances) else float("nan")


def _scans_of_a_view(range_m: float, motion: Motion) -> int:
    """Scans in a row from which objects at that range look alike."""
    scan_m = float(motion.travel_m[-1]) / len(motion.travel_m)
    return int(np.clip(SAME_VIEW_RAD * range_m / max(scan_m, 1e-9), 1, MOST_REPEATED))


def _claimed_ratio(tracks: ObjectTracks, estimate: ComponentEstimate | None) -> float:
    """Horizontal variance of detections as estimated, by that which their messages claim."""
    claimed = tracks.claimed[np.isfinite(tracks.claimed)]
    if estimate is None or len(claimed) == 0:
        return float("nan")
    square = np.einsum("ni,ni->n", tracks.offsets, tracks.offsets)[np.isfinite(tracks.claimed)]
    return estimate.repeated * estimate.white(float(np.mean(square)))[0] / float(np.mean(claimed))


def _correction(share: float, corrected: float) -> float:
    """Factor on what is too small by a share and was ``corrected`` by a factor before; 1 if nothing is to be done."""
    least = NOTED_SHARE if corrected == 1.0 else LEAST_SHARE
    return 1.0 + share if least < abs(share) < MOST_SHARE else 1.0


class _Gathered:
    """The records of a log that a survey needs."""

    def __init__(self, frames: SensorFrames, max_classes: int) -> None:
        self._max_classes = max_classes
        self._odometry: list[Odometry] = []
        self._detections: list[ObjectDetections] = []
        self._frames = frames
        self._count = 0
        self._latest: tuple[tuple[str, float, int], list[SurveyScan]] | None = None
        self._followed: tuple[list[SurveyScan], ObjectTracks] | None = None
        self.scales = 1.0, 1.0
        """Factors by which lengths and turns of the odometry were corrected."""

    def add(self, record: Record) -> int:
        """Take in a record; returns the detections so far."""
        if isinstance(record, Odometry):
            self._odometry.append(record)
        elif isinstance(record, Transform):
            self._frames.add(record)
        elif isinstance(record, ObjectDetections):
            self._detections.append(record)
            self._count += len(record.positions)
        return self._count

    def judge_labels(self, config: DetectionCalibration) -> LabelNoise:
        """How far labels can be trusted; where they say nothing, all scans to come have one class."""
        scans = self.scans(config, 0.0)
        labels = estimate_label_noise(scans, _headings(scans)) if len(scans) > 1 else LabelNoise()
        if labels.is_useless:
            self._max_classes = 1
        return labels

    def scans(self, config: DetectionCalibration, delay_s: float) -> list[SurveyScan]:
        """The scans that lie on the odometry, corrected, in the order of their stamps, without empty ones.

        Of messages of one sensor with one stamp the first is used, as in the map.
        """
        corrections = config.model_dump_json(), delay_s, self._max_classes
        if self._latest is None or self._latest[0] != corrections:
            self._latest = corrections, self._corrected_scans(config, delay_s)
        return self._latest[1]

    def tracks(self, scans: list[SurveyScan]) -> ObjectTracks:
        """The tracks of the objects in scans; those of the last scans are kept."""
        if self._followed is None or self._followed[0] is not scans:
            self._followed = scans, objects_among(follow_objects(scans, _headings(scans)))
        return self._followed[1]

    def _corrected_scans(self, config: DetectionCalibration, delay_s: float) -> list[SurveyScan]:
        stamps, poses = self._track()
        delay_ns = round(delay_s * 1e9)
        if len(stamps) < 2:
            return []
        vocabulary: defaultdict[str, int] = defaultdict()
        vocabulary.default_factory = vocabulary.__len__
        first = dict[tuple[int, str], ObjectDetections]()
        for detections in self._detections:
            first.setdefault((detections.stamp_ns, detections.frame_id), detections)
        usable = [d for d in first.values() if stamps[0] <= d.stamp_ns + delay_ns <= stamps[-1] and len(d.positions)]
        usable.sort(key=lambda detections: detections.stamp_ns)
        T_odom_body = interpolate(stamps, poses, np.array([d.stamp_ns + delay_ns for d in usable], dtype=np.int64))
        T_upright_body = invert(transform_from_xyz_yaw(T_odom_body[:, :3, 3], yaw_rad(T_odom_body))) @ T_odom_body
        scans = []
        for detections, T, T_upright in zip(usable, T_odom_body, T_upright_body, strict=True):
            T_body_sensor = find_sensor(self._frames, detections, self._odometry[0], T, config)
            if T_body_sensor is None:
                continue
            scans.append(_upright_scan(detections, T, T_upright @ T_body_sensor, vocabulary, config))
            np.minimum(scans[-1].labels, self._max_classes - 1, out=scans[-1].labels)
        return _without_far_off(scans)

    def detour(self) -> float:
        """The length of the odometry's path by that of its every second message; 1 where it stands still."""
        _, poses = self._track()
        full_m, half_m = _path_length(poses), _path_length(poses[::2])
        return full_m / half_m if half_m > 0.0 else 1.0

    def follow_one_source(self) -> bool:
        """Keep the odometry of one of two sources, if that alone makes no detour."""
        both, source = self._odometry, FollowedSource()
        self._odometry = [odometry for odometry in both if source.follows(odometry)]
        if self.detour() > NOTED_DETOUR:
            self._odometry = both
        return len(self._odometry) < len(both)

    def scale_odometry(self, errors: InputErrors, given: Collection[str]) -> bool:
        """Correct the lengths and turns of the odometry, but for those that are ``given``; returns whether any was."""
        length = 1.0 if "length_scale" in given else _correction(errors.length_share, self.scales[0])
        turn = 1.0 if "turn_scale" in given else _correction(errors.turn_share, self.scales[1])
        if (length, turn) == (1.0, 1.0):
            return False
        self.scales = self.scales[0] * length, self.scales[1] * turn
        scaled = ScaledOdometry(length_scale=length, turn_scale=turn)
        self._odometry = [scaled.correct(odometry) for odometry in self._odometry]
        self._latest = None
        return True

    def motion(self, scans: list[SurveyScan], delay_s: float) -> BodyMotion:
        """How the body moves at the scans, by the odometry half an interval of the scans before and after each."""
        stamps, poses = self._track()
        at = np.array([scan.stamp_ns for scan in scans], dtype=np.int64) + round(delay_s * 1e9)
        half = max(int(np.median(np.diff(at))), int(np.median(np.diff(stamps))), 1)
        before, after = np.maximum(at - half, stamps[0]), np.minimum(at + half, stamps[-1])
        T_before, T_after = interpolate(stamps, poses, before), interpolate(stamps, poses, after)
        seconds = np.maximum((after - before) * 1e-9, 1e-9)
        turned = (yaw_rad(T_after) - yaw_rad(T_before) + np.pi) % (2.0 * np.pi) - np.pi
        return BodyMotion(
            positions=np.stack([scan.T_odom_body[:2, 3] for scan in scans]),
            headings=_headings(scans),
            velocities=(T_after - T_before)[:, :2, 3] / seconds[:, None],
            turn_rates=turned / seconds,
        )

    def _track(self) -> tuple[IntArray, FloatArray]:
        """Stamps (K,), strictly increasing, and poses (K, 4, 4) of the odometry."""
        stamps = np.array([odometry.stamp_ns for odometry in self._odometry], dtype=np.int64)
        if len(stamps) == 0:
            return stamps, np.zeros((0, 4, 4))
        latest_before = np.concatenate([[np.iinfo(np.int64).min], np.maximum.accumulate(stamps)[:-1]])
        used = stamps > latest_before
        return stamps[used], np.stack([self._odometry[row].T_odom_body for row in np.flatnonzero(used).tolist()])


def _upright_scan(
    detections: ObjectDetections,
    T_odom_body: FloatArray,
    T_upright_sensor: FloatArray,
    vocabulary: defaultdict[str, int],
    config: DetectionCalibration,
) -> SurveyScan:
    positions = apply(T_upright_sensor, detections.positions)
    used = np.isfinite(positions).all(axis=1) & is_wanted(detections, config)
    variances = np.full(len(positions), np.nan)
    if detections.covariances is not None:
        variances = np.trace(detections.covariances, axis1=1, axis2=2) / 3.0
        variances[variances == 0.0] = np.nan
    return SurveyScan(
        detections.stamp_ns,
        T_odom_body,
        positions[used],
        np.array([vocabulary[label] for label in detections.labels], dtype=np.int64)[used],
        variances[used],
    )
