"""The odometry and the detections of a log as scans that are corrected by a calibration."""

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace

import numpy as np

from logs.messages import ObjectDetections, Odometry, Record, Transform
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import Calibration, OdometryCalibration
from slam.common.geometry import apply_each, gravity_frame, interpolate, invert, step_lengths, travelled_m, yaw_rad
from slam.frontend.input.scan import in_metres, is_wanted
from slam.frontend.input.sensor_frames import SensorFrames, find_sensor
from slam.odometry.calibrated_odometry import CalibratedOdometry
from slam.self_calibration.corrections import BodyMotion
from slam.self_calibration.object_tracks import SurveyScan, headings_of, poses_of, seconds_of
from slam.self_calibration.variance_components import CLIP

MAX_DETECTIONS = 150_000
"""A survey ends after that many detections; what it estimates has converged by then."""
FAR_OFF = 100.0
"""Detections beyond so many median ranges are treated as outliers."""
MAX_DETOUR = 1.5
"""Poses of one source hardly ever go back with every other message."""


class SurveyedLog:
    """What a survey needs of ``records``, which are read until there are so many detections.

    ``frames``: where the sensors sit, as far as it is known already.
    """

    def __init__(
        self, records: Iterable[Record], frames: SensorFrames | None = None, *, max_detections: int = MAX_DETECTIONS
    ) -> None:
        self._odometry: list[Odometry] = []
        self._detections: list[ObjectDetections] = []
        self._frames = frames or SensorFrames()
        self._latest_track: tuple[OdometryCalibration, IntArray, FloatArray] | None = None
        count = 0
        for record in records:
            if isinstance(record, Odometry):
                self._odometry.append(record)
            elif isinstance(record, Transform):
                self._frames.add(record)
            elif isinstance(record, ObjectDetections):
                self._detections.append(record)
                count += len(record.positions)
            if count >= max_detections:
                break
        self._odometry = _without_repeats(self._odometry)

    def detour(self) -> float:
        """Ratio of the length of the odometry's path to that of every second message; 1 at standstill."""
        _, poses = self._track(Calibration())
        full_m, half_m = _path_length(poses), _path_length(poses[::2])
        return full_m / half_m if half_m > 0.0 else 1.0

    def rotations(self) -> FloatArray:
        """Rotations (K, 3, 3) of the body in the frame of the odometry's messages."""
        return self._track(Calibration())[1][:, :3, :3]

    def scans(self, calibration: Calibration, vocabulary: dict[str, int]) -> tuple[list[SurveyScan], BodyMotion]:
        """Corrected scans with odometry, in the order of their stamps, without empty ones, and the motion of the body
        at them.

        Of messages of one sensor with one stamp the first is used, as in the map. ``vocabulary``: numbers of the
        classes, to which new ones are added.
        """
        stamps, poses = self._track(calibration)
        delay_ns = round(calibration.detection.time_offset_s * 1e9)
        if len(stamps) < 2:
            return [], _motion([], stamps, poses, delay_ns)
        first = dict[tuple[int, str], ObjectDetections]()
        for detections in self._detections:
            first.setdefault((detections.stamp_ns, detections.frame_id), detections)
        usable = [d for d in first.values() if stamps[0] <= d.stamp_ns + delay_ns <= stamps[-1] and len(d.positions)]
        usable.sort(key=lambda detections: detections.stamp_ns)
        T_odom_body = interpolate(stamps, poses, np.array([d.stamp_ns + delay_ns for d in usable], dtype=np.int64))
        T_upright_body = invert(gravity_frame(T_odom_body)) @ T_odom_body
        T_reported_body = invert(calibration.odometry.T_level_odom) @ T_odom_body
        placed = []
        for detections, T, T_reported, T_upright in zip(
            usable, T_odom_body, T_reported_body, T_upright_body, strict=True
        ):
            T_body_sensor = find_sensor(self._frames, detections, self._odometry[0], T_reported, calibration.detection)
            if T_body_sensor is not None:
                placed.append((in_metres(detections, calibration.detection), T, T_upright @ T_body_sensor))
        scans = _upright_scans(placed, vocabulary, calibration) if placed else []
        return scans, _motion(scans, stamps, poses, delay_ns)

    def poses_at(self, stamps_ns: IntArray, calibration: Calibration, delay_s: float) -> FloatArray:
        """Poses (K, 4, 4) of the body at the stamps (K,) of scans, if they are so much later than the calibration says;
        the first or last pose beyond the ends of the odometry.
        """
        stamps, poses = self._track(calibration)
        late_ns = round((calibration.detection.time_offset_s + delay_s) * 1e9)
        return interpolate(stamps, poses, stamps_ns + late_ns)

    def _track(self, calibration: Calibration) -> tuple[IntArray, FloatArray]:
        """Stamps (K,), strictly increasing, and poses (K, 4, 4) of the odometry, corrected by the calibration."""
        if self._latest_track is not None and self._latest_track[0] == calibration.odometry:
            return self._latest_track[1:]
        odometry = self._odometry
        if calibration.odometry != OdometryCalibration():
            calibrated = CalibratedOdometry(calibration.odometry)
            odometry = [calibrated.correct(each) for each in odometry]
        stamps = np.array([each.stamp_ns for each in odometry], dtype=np.int64)
        if len(stamps) == 0:
            return stamps, np.zeros((0, 4, 4))
        used = np.diff(np.maximum.accumulate(stamps), prepend=stamps[0] - 1) > 0
        poses = np.stack([odometry[row].T_odom_body for row in np.flatnonzero(used).tolist()])
        poses = calibration.odometry.T_level_odom @ poses
        self._latest_track = calibration.odometry, stamps[used], poses
        return stamps[used], poses


def scans_of(logs: Sequence[SurveyedLog], calibration: Calibration) -> tuple[list[SurveyScan], BodyMotion]:
    """The scans of several logs of one robot as of one drive: each begins a second after the last, where that ended."""
    scans, motions, vocabulary = list[SurveyScan](), list[BodyMotion](), dict[str, int]()
    for log in logs:
        more, motion = log.scans(calibration, vocabulary)
        if scans and more:
            later_ns = scans[-1].stamp_ns + 10**9 - more[0].stamp_ns
            shift = np.zeros((4, 4))
            shift[:3, 3] = (scans[-1].T_odom_body - more[0].T_odom_body)[:3, 3]
            more = [
                replace(scan, stamp_ns=scan.stamp_ns + later_ns, T_odom_body=scan.T_odom_body + shift) for scan in more
            ]
            motion = replace(motion, positions=motion.positions + shift[:3, 3])
        scans += more
        motions.append(motion)
    joined = (np.concatenate([getattr(each, field.name) for each in motions]) for field in fields(BodyMotion))
    return scans, BodyMotion(*joined)


def _without_repeats(odometry: list[Odometry]) -> list[Odometry]:
    """The messages without repeated poses, where a source usually repeats each until it has the next one; the body
    stands where it repeats one more than twice as often as usual.
    """
    poses = np.array([each.T_odom_body for each in odometry]).reshape(-1, 16)
    starts = np.flatnonzero(np.any(np.diff(poses, axis=0, prepend=np.nan) != 0.0, axis=1))
    lengths = np.diff(starts, append=len(poses))
    usual = np.median(lengths) if len(lengths) else 1
    if usual < 2:
        return odometry
    ends = (starts + lengths - 1)[(lengths > 2 * usual) | (starts == starts[-1])]
    return [odometry[row] for row in np.union1d(starts, ends).tolist()]


def _motion(scans: list[SurveyScan], stamps: IntArray, poses: FloatArray, delay_ns: int) -> BodyMotion:
    """By the odometry half an interval of the scans before and after each."""
    positions, headings = poses_of(scans)[:, :3, 3], headings_of(scans)
    if len(scans) < 2:
        return BodyMotion(positions, headings, np.zeros((len(scans), 2)), *np.zeros((3, len(scans))))
    at = np.array([scan.stamp_ns for scan in scans], dtype=np.int64) + delay_ns
    half = max(int(np.median(np.diff(at))), int(np.median(np.diff(stamps))), 1)
    before, after = np.maximum(at - half, stamps[0]), np.minimum(at + half, stamps[-1])
    T_before, T_after = interpolate(stamps, poses, before), interpolate(stamps, poses, after)
    seconds = np.maximum((after - before) * 1e-9, 1e-9)
    turned = (yaw_rad(T_after) - yaw_rad(T_before) + np.pi) % (2.0 * np.pi) - np.pi
    velocities = (T_after - T_before)[:, :2, 3] / seconds[:, None]
    travels = np.interp(at - stamps[0], stamps - stamps[0], travelled_m(poses[:, :2, 3]))
    return BodyMotion(positions, headings, velocities, turned / seconds, seconds_of(scans), travels)


def _path_length(poses: FloatArray) -> float:
    """Length [m] of the path through poses (K, 4, 4); single messages that are far off add little."""
    steps_m = step_lengths(poses[:, :3, 3])
    moved = steps_m > 0.0
    return np.minimum(steps_m, CLIP * np.median(steps_m[moved])).sum() if moved.any() else 0.0


def _upright_scans(
    placed: Sequence[tuple[ObjectDetections, FloatArray, FloatArray]],
    vocabulary: dict[str, int],
    calibration: Calibration,
) -> list[SurveyScan]:
    """Scans of messages, each with ``T_odom_body`` (4, 4) and ``T_upright_sensor`` (4, 4), without detections that are
    implausibly far away, and without empty scans.
    """
    messages, T_odom_body, T_upright_sensor = zip(*placed, strict=True)
    counts = [len(each.positions) for each in messages]
    covariances = [
        np.full((len(each.positions), 3, 3), np.nan) if each.covariances is None else each.covariances
        for each in messages
    ]
    variances = np.trace(np.concatenate(covariances), axis1=1, axis2=2) / 3.0
    variances[variances == 0.0] = np.nan
    names = [vocabulary.setdefault(label, len(vocabulary)) for each in messages for label in each.labels]
    labels = np.minimum(np.array(names, dtype=np.int64), calibration.objects.max_classes - 1)
    seen = np.concatenate([each.positions for each in messages])
    positions = apply_each(np.repeat(T_upright_sensor, counts, axis=0), seen)
    used = np.isfinite(positions).all(axis=1)
    used &= np.concatenate([is_wanted(each, calibration.detection) for each in messages])
    ranges = np.hypot(positions[:, 0], positions[:, 1])
    if used.any():
        used &= ranges <= FAR_OFF * np.median(ranges[used])
    scans, rows_of = [], np.split(np.arange(len(used)), np.cumsum(counts)[:-1])
    for message, T, rows in zip(messages, T_odom_body, rows_of, strict=True):
        kept = rows[used[rows]]
        if len(kept):
            scans.append(SurveyScan(message.stamp_ns, T, positions[kept], labels[kept], variances[kept]))
    return scans
