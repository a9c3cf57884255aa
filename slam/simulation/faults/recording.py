"""A log in memory, and the elementary changes of faults; each returns another recording."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from logs.messages import (
    DetectionTruth,
    GroundTruthPose,
    ObjectDetections,
    ObjectMapRecord,
    Odometry,
    Record,
    Transform,
)
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, interpolate, invert
from slam.frontend.input.sensor_frames import SensorFrames

RecordT = TypeVar("RecordT", bound=Record, covariant=True)


@dataclass(frozen=True, slots=True, eq=False)
class Message(Generic[RecordT]):
    """A record, where and when it was logged; ``number``: of the message in the log, which orders equal log times."""

    topic: str
    log_time_ns: int
    record: RecordT
    number: int = 0

    def with_fields(self, **fields: Any) -> Message[RecordT]:
        """The message with other fields of its record."""
        record: Any = self.record
        return replace(self, record=replace(record, **fields))


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A message of detections and, where the log has it, the one of their true ids."""

    message: Message[ObjectDetections]
    truth: Message[DetectionTruth] | None = None

    @property
    def detections(self) -> ObjectDetections:
        """What was detected."""
        return self.message.record

    @property
    def stamp_ns(self) -> int:
        """Stamp of the detections."""
        return self.detections.stamp_ns

    @property
    def ids(self) -> tuple[str, ...]:
        """The true id of each detection; () where they are not known."""
        return () if self.truth is None else self.truth.record.object_ids

    def having(self, detections: ObjectDetections, ids: Sequence[str] | None = None) -> Scan:
        """The scan with other detections, and other true ids where these are given."""
        truth = self.truth and self.truth.with_fields(
            stamp_ns=detections.stamp_ns, object_ids=self.ids if ids is None else tuple(ids)
        )
        return Scan(replace(self.message, record=detections), truth)

    def with_fields(self, **fields: Any) -> Scan:
        """The scan with other fields of its detections."""
        return self.having(replace(self.detections, **fields))

    def select(self, rows: NDArray[np.bool_]) -> Scan:
        """The detections ``rows`` (N,), with their true ids."""
        ids = [name for name, is_kept in zip(self.ids, rows.tolist(), strict=False) if is_kept]
        return self.having(take_detections(self.detections, np.flatnonzero(rows)), ids)

    def join(self, false: ObjectDetections) -> Scan:
        """The scan with detections of nothing that is in the truth."""
        return self.having(join_detections(self.detections, false), (*self.ids, *[""] * len(false.labels)))


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Records of a log that faults read and change, each kind in its order; ``odometry`` has at least one message.

    ``keeps_others``: whether topics of other kinds belong to it.
    """

    odometry: tuple[Message[Odometry], ...]
    scans: tuple[Scan, ...] = ()
    transforms: tuple[Message[Transform], ...] = ()
    true_poses: tuple[Message[GroundTruthPose], ...] = ()
    true_objects: tuple[Message[ObjectMapRecord], ...] = ()
    keeps_others: bool = True

    @property
    def messages(self) -> list[Message[Record]]:
        """All messages, in the order of the log."""
        scans = [message for scan in self.scans for message in (scan.message, scan.truth) if message is not None]
        found = [*self.odometry, *scans, *self.transforms, *self.true_poses, *self.true_objects]
        return sorted(found, key=lambda message: (message.log_time_ns, message.number))

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp of odometry and detections."""
        stamps = [*self.stamps_ns.tolist(), *(scan.stamp_ns for scan in self.scans)]
        return min(stamps), max(stamps)

    def stamp_at(self, fraction: float) -> int:
        """The stamp at a part of the time of the drive, in [0, 1]."""
        first_ns, last_ns = self.span_ns
        return first_ns + round(fraction * (last_ns - first_ns))

    @property
    def half_ns(self) -> int:
        """The stamp in the middle of the drive."""
        return self.stamp_at(0.5)

    def from_half(self, seconds: float) -> tuple[int, int]:
        """The stamp in the middle of the drive, and so long after it."""
        return self.half_ns, self.half_ns + seconds_ns(seconds)

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps (N,) of the odometry."""
        return np.array([message.record.stamp_ns for message in self.odometry], dtype=np.int64)

    @property
    def poses(self) -> FloatArray:
        """Poses T_odom_body (N, 4, 4) of the odometry."""
        return np.array([message.record.T_odom_body for message in self.odometry])

    @property
    def steps(self) -> FloatArray:
        """T_previous_next (N - 1, 4, 4) of the odometry."""
        return steps_of(self.poses)

    def row_at(self, fraction: float) -> int:
        """The first pose after a part of the time of the drive, N where there is none."""
        return int(np.searchsorted(self.stamps_ns, self.stamp_at(fraction)))

    def poses_at(self, stamps_ns: Sequence[int] | IntArray) -> FloatArray:
        """Poses T_odom_body (M, 4, 4) at the stamps (M,), those of the ends outside of the odometry."""
        return _interpolate(self.stamps_ns, self.poses, stamps_ns)

    def true_poses_at(self, stamps_ns: Sequence[int] | IntArray) -> FloatArray:
        """True poses T_world_body (M, 4, 4) at the stamps (M,), those of the ends outside of the truth.

        Raises:
            SimulationError: there is no true pose.
        """
        found = [message.record for message in self.true_poses]
        if not found:
            raise SimulationError("the log holds no true poses, which this fault needs: record /ground_truth")
        known_ns = np.array([pose.stamp_ns for pose in found], dtype=np.int64)
        return _interpolate(known_ns, np.array([pose.T_world_body for pose in found]), stamps_ns)

    def with_poses(self, T_odom_body: FloatArray) -> Recording:
        """Other poses (N, 4, 4) of the odometry."""
        pairs = zip(self.odometry, T_odom_body, strict=True)
        return replace(self, odometry=tuple(message.with_fields(T_odom_body=T) for message, T in pairs))

    def with_steps(self, steps: FloatArray) -> Recording:
        """Poses from the first one on by other steps (N - 1, 4, 4)."""
        poses = [self.poses[0]]
        for step in steps:
            poses.append(poses[-1] @ step)
        return self.with_poses(np.array(poses))

    def redirected(self, row: int, T_jump: FloatArray) -> Recording:
        """Poses from ``row`` on moved rigidly, by ``T_jump`` (4, 4) in the axes of the body at ``row``."""
        poses = self.poses
        if row < len(poses):
            poses[row:] = poses[row] @ T_jump @ invert(poses[row]) @ poses[row:]
        return self.with_poses(poses)

    def with_scans(self, scans: Iterable[Scan]) -> Recording:
        """Other scans."""
        return replace(self, scans=tuple(scans))

    def with_detections(self, alter: Callable[[ObjectDetections], ObjectDetections]) -> Recording:
        """Each message of detections altered, which keeps their number and their stamp."""
        return self.with_scans(scan.having(alter(scan.detections)) for scan in self.scans)

    def restamped(self, new_stamp_ns: Callable[[int], int]) -> Recording:
        """Other stamps of the scans, without those whose stamp would be before zero."""
        stamps = [new_stamp_ns(scan.stamp_ns) for scan in self.scans]
        pairs = zip(self.scans, stamps, strict=True)
        return self.with_scans(scan.with_fields(stamp_ns=stamp_ns) for scan, stamp_ns in pairs if stamp_ns >= 0)

    def select_scans(self, is_kept: Callable[[int], bool]) -> Recording:
        """The scans of some stamps."""
        return self.with_scans(scan for scan in self.scans if is_kept(scan.stamp_ns))

    def select_detections(self, choose: Callable[[ObjectDetections], NDArray[np.bool_]]) -> Recording:
        """The chosen detections."""
        return self.with_scans(scan.select(choose(scan.detections)) for scan in self.scans)

    @property
    def scans_with_ids(self) -> list[Scan]:
        """The scans whose true ids are known.

        Raises:
            SimulationError: there is none.
        """
        found = [scan for scan in self.scans if scan.truth is not None]
        if not found:
            raise SimulationError(
                "the log holds no true ids of its detections (/ground_truth/detections), which this fault needs"
            )
        return found

    @property
    def labels(self) -> list[str]:
        """All labels of the detections, sorted."""
        return sorted({label for scan in self.scans for label in scan.detections.labels})

    def body_frames(self) -> Callable[[str], FloatArray]:
        """A function from a sensor's frame to T_body_sensor (4, 4); the identity without a transform."""
        frames, body = SensorFrames(), self.odometry[0].record.child_frame_id
        for message in self.transforms:
            frames.add(message.record)

        def T_body_sensor(frame: str) -> FloatArray:
            found = None if frame in ("", body) else frames.find(body, frame)
            return np.eye(4) if found is None else found

        return T_body_sensor

    def bearing_frames(self) -> Callable[[str], FloatArray]:
        """As :meth:`body_frames`, where it matters from which place an object was seen.

        Raises:
            SimulationError: detections are in the frame of the odometry.
        """
        odometry = self.odometry[0].record
        if odometry.frame_id in {scan.detections.frame_id for scan in self.scans} - {"", odometry.child_frame_id}:
            raise SimulationError(
                f"detections are in {odometry.frame_id!r}, the frame of the odometry, which gives neither their range "
                "nor their bearing: record them in a sensor's frame"
            )
        return self.body_frames()


def make_recording(messages: Iterable[Message[Record]]) -> Recording:
    """The recording of the messages of a log. True ids without detections of their stamp and number are left out.

    Raises:
        SimulationError: there is no odometry.
    """
    by_kind: defaultdict[type, list[Any]] = defaultdict(list)
    for message in messages:
        by_kind[type(message.record)].append(message)
    if not by_kind[Odometry]:
        raise SimulationError("the log holds no odometry, so no fault can be applied")
    truths: defaultdict[int, deque[Message[DetectionTruth]]] = defaultdict(deque)
    for truth in by_kind[DetectionTruth]:
        truths[truth.record.stamp_ns].append(truth)
    scans = []
    for message in by_kind[ObjectDetections]:
        waiting = truths[message.record.stamp_ns]
        truth = waiting.popleft() if waiting else None
        fits = truth is not None and len(truth.record.object_ids) == len(message.record.labels)
        scans.append(Scan(message, truth if fits else None))
    transforms, true_poses, true_objects = (
        tuple(by_kind[kind]) for kind in (Transform, GroundTruthPose, ObjectMapRecord)
    )
    return Recording(tuple(by_kind[Odometry]), tuple(scans), transforms, true_poses, true_objects)


def by_log_time(messages: Iterable[Message[RecordT]]) -> tuple[Message[RecordT], ...]:
    """The messages in the order of log time; those of equal time keep theirs."""
    return tuple(sorted(messages, key=lambda message: message.log_time_ns))


def seconds_ns(seconds: float) -> int:
    """Whole nanoseconds."""
    return round(seconds * 1e9)


def steps_of(poses: FloatArray) -> FloatArray:
    """T_previous_next (N - 1, 4, 4) of N poses."""
    return invert(poses[:-1]) @ poses[1:]


def _interpolate(stamps_ns: IntArray, T_a_b: FloatArray, at_ns: Sequence[int] | IntArray) -> FloatArray:
    """Poses (M, 4, 4) at ``at_ns`` (M,) of the poses (N, 4, 4) at ``stamps_ns`` (N,) in any order."""
    ordered, first = np.unique(stamps_ns, return_index=True)
    at = np.clip(np.asarray(at_ns, dtype=np.int64), ordered[0], ordered[-1])
    return interpolate(ordered, T_a_b[first], at)


def take_detections(detections: ObjectDetections, rows: IntArray) -> ObjectDetections:
    """The detections ``rows`` (M,)."""
    taken: dict[str, Any] = {
        name: None if (values := getattr(detections, name)) is None else values[rows]
        for name in ("positions", "scores", "covariances", "sizes")
    }
    ids = detections.track_ids
    return replace(
        detections,
        labels=tuple(detections.labels[i] for i in rows),
        track_ids=None if ids is None else tuple(ids[i] for i in rows),
        **taken,
    )


def move_detections(detections: ObjectDetections, T: FloatArray) -> ObjectDetections:
    """The detections with positions and covariances moved by a transform (4, 4)."""
    R, covariances = T[:3, :3], detections.covariances
    return replace(
        detections,
        positions=apply(T, detections.positions),
        covariances=None if covariances is None else R @ covariances @ R.T,
    )


def join_detections(first: ObjectDetections, *more: ObjectDetections) -> ObjectDetections:
    """All detections in one message like ``first``; covariances and sizes that only some have are zero for the others,
    and track ids "".
    """
    parts = [part for part in (first, *more) if part.labels] or [first]

    def stack(arrays: list[FloatArray | None], shape: tuple[int, ...]) -> FloatArray | None:
        if all(array is None for array in arrays):
            return None
        zeros = [np.zeros((len(part.labels), *shape)) for part in parts]
        return np.concatenate([zero if array is None else array for array, zero in zip(arrays, zeros, strict=True)])

    has_ids = any(part.track_ids is not None for part in parts)
    return replace(
        first,
        positions=np.concatenate([part.positions for part in parts]),
        labels=tuple(label for part in parts for label in part.labels),
        scores=np.concatenate([part.scores for part in parts]),
        covariances=stack([part.covariances for part in parts], (3, 3)),
        sizes=stack([part.sizes for part in parts], (3,)),
        track_ids=tuple(i for part in parts for i in part.track_ids or ("",) * len(part.labels)) if has_ids else None,
    )
