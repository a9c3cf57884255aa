"""A log in memory, which faults change in place. Messages are replaced, never changed."""

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, compress
from typing import Any, Generic, TypeVar

import numpy as np

from logs.dslam_codec import take_rows
from logs.messages import (
    DetectionTruth,
    GroundTruthPose,
    ObjectDetections,
    ObjectMapRecord,
    Odometry,
    Record,
    Transform,
)
from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.errors import SimulationError
from slam.common.geometry import interpolate, invert
from slam.frontend.input.sensor_frames import SensorFrames

RecordT = TypeVar("RecordT", bound=Record, covariant=True)


@frozen
class Message(Generic[RecordT]):
    """A record, where and when it was logged; ``number``: of the message in the log, which orders equal log times."""

    topic: str
    log_time_ns: int
    record: RecordT
    number: int = 0

    def having(self, **fields: Any) -> "Message[RecordT]":
        """The message with other fields of its record."""
        record: Any = self.record
        return replace(self, record=replace(record, **fields))


@dataclass(slots=True, eq=False)
class Scan:
    """A message of detections and, where the log has it, the one of their true ids."""

    message: Message[ObjectDetections]
    truth: Message[DetectionTruth] | None = None

    @property
    def seen(self) -> ObjectDetections:
        """What was detected."""
        return self.message.record

    @property
    def stamp_ns(self) -> int:
        """Stamp of the detections."""
        return self.seen.stamp_ns

    @property
    def ids(self) -> tuple[str, ...]:
        """The true id of each detection; () where they are not known."""
        return () if self.truth is None else self.truth.record.object_ids

    def put(self, seen: ObjectDetections, ids: tuple[str, ...]) -> None:
        """Put other detections in the place of these, with their true ids."""
        self.message = replace(self.message, record=seen)
        if self.truth is not None:
            self.truth = self.truth.having(stamp_ns=seen.stamp_ns, object_ids=ids)

    def change(self, **fields: Any) -> None:
        """Give the detections other fields."""
        self.put(replace(self.seen, **fields), self.ids)

    def move(self, T: FloatArray) -> None:
        """Move positions and covariances by a transform (4, 4)."""
        R, t, seen = T[:3, :3], T[:3, 3], self.seen
        covariances = None if seen.covariances is None else R @ seen.covariances @ R.T
        self.change(positions=seen.positions @ R.T + t, covariances=covariances)

    def keep(self, is_kept: BoolArray) -> None:
        """Keep the detections of a mask (N,), with their true ids."""
        self.put(take_rows(self.seen, N=np.flatnonzero(is_kept)), tuple(compress(self.ids, is_kept)))

    def add(self, false: ObjectDetections) -> None:
        """Add detections of nothing that is in the truth."""
        self.put(joined([self.seen, false]), (*self.ids, *[""] * len(false.labels)))


@dataclass(slots=True, eq=False)
class Recording:
    """What faults read and change of a log, each kind in its order; ``odometry`` has one message at least; ``others``:
    transforms, true poses and true objects.
    """

    odometry: list[Message[Odometry]]
    scans: list[Scan]
    others: list[Message[Record]]

    @property
    def messages(self) -> list[Message[Record]]:
        """All messages, in the order of the log."""
        scans = [message for scan in self.scans for message in (scan.message, scan.truth) if message is not None]
        return sorted([*self.odometry, *scans, *self.others], key=lambda message: (message.log_time_ns, message.number))

    def stamp_at(self, fraction: float) -> int:
        """The stamp at a part of the time of the drive, in [0, 1]."""
        stamps: list[int] = [*self.stamps_ns.tolist(), *(scan.stamp_ns for scan in self.scans)]
        return min(stamps) + round(fraction * (max(stamps) - min(stamps)))

    def from_half(self, seconds: float) -> tuple[int, int]:
        """The stamp at half time, and so long after it."""
        half_ns = self.stamp_at(0.5)
        return half_ns, half_ns + seconds_ns(seconds)

    def are_after_half(self, seconds: float) -> BoolArray:
        """Which stamps (N,) of the odometry are within so long from half time on."""
        begin_ns, end_ns = self.from_half(seconds)
        return (self.stamps_ns >= begin_ns) & (self.stamps_ns < end_ns)

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps (N,) of the odometry."""
        return np.array([message.record.stamp_ns for message in self.odometry], dtype=np.int64)

    @property
    def poses(self) -> FloatArray:
        """Poses T_odom_body (N, 4, 4) of the odometry."""
        return np.array([message.record.T_odom_body for message in self.odometry])

    @poses.setter
    def poses(self, T_odom_body: FloatArray) -> None:
        pairs = zip(self.odometry, T_odom_body, strict=True)
        self.odometry = [message.having(T_odom_body=T) for message, T in pairs]

    @property
    def steps(self) -> FloatArray:
        """T_previous_next (N - 1, 4, 4) of the odometry."""
        return invert(self.poses[:-1]) @ self.poses[1:]

    @steps.setter
    def steps(self, steps: FloatArray) -> None:
        self.poses = np.array(list(accumulate(steps, np.matmul, initial=self.poses[0])))

    def row_at(self, fraction: float) -> int:
        """The first pose after a part of the time of the drive, the last one where there is none."""
        return min(int(np.searchsorted(self.stamps_ns, self.stamp_at(fraction))), len(self.odometry) - 1)

    def scan_poses(self) -> FloatArray:
        """Poses T_odom_body (S, 4, 4) at the scans, those of the ends outside of the odometry."""
        ordered, first = np.unique(self.stamps_ns, return_index=True)
        at = np.array([scan.stamp_ns for scan in self.scans], dtype=np.int64)
        return interpolate(ordered, self.poses[first], at)

    def redirect(self, row: int, T_jump: FloatArray) -> None:
        """Move the poses from ``row`` on rigidly, by ``T_jump`` (4, 4) in the axes of the body at ``row``."""
        poses = self.poses
        # The transpose, as the inverse of a rotation, would double its rounding with each of many jumps.
        poses[row:] = poses[row] @ T_jump @ np.linalg.inv(poses[row]) @ poses[row:]
        self.poses = poses

    def restamp_scans(self, new_stamp_ns: Callable[[int], int]) -> None:
        """Give the scans other stamps; those whose stamp would be before zero are left out."""
        self.scans = [scan for scan in self.scans if new_stamp_ns(scan.stamp_ns) >= 0]
        for scan in self.scans:
            scan.change(stamp_ns=new_stamp_ns(scan.stamp_ns))

    @property
    def labels(self) -> list[str]:
        """All labels of the detections, sorted."""
        return sorted({label for scan in self.scans for label in scan.seen.labels})

    def body_frames(self) -> Callable[[str], FloatArray]:
        """A function from a sensor's frame to T_body_sensor (4, 4); the identity without a transform."""
        frames, body = SensorFrames(), self.odometry[0].record.child_frame_id
        for message in self.others:
            if isinstance(message.record, Transform):
                frames.add(message.record)

        def T_body_sensor(frame: str) -> FloatArray:
            found = None if frame in ("", body) else frames.find(body, frame)
            return np.eye(4) if found is None else found

        return T_body_sensor


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
    others = [*by_kind[Transform], *by_kind[GroundTruthPose], *by_kind[ObjectMapRecord]]
    return Recording(by_kind[Odometry], scans, others)


def seconds_ns(seconds: float) -> int:
    """Whole nanoseconds."""
    return round(seconds * 1e9)


def joined(every: Sequence[ObjectDetections]) -> ObjectDetections:
    """All detections in the first message; covariances that only some have are zero for the others."""
    covariances = [
        np.zeros((len(part.labels), 3, 3)) if part.covariances is None else part.covariances for part in every
    ]
    are_known = any(part.covariances is not None for part in every)
    return replace(
        every[0],
        positions=np.concatenate([part.positions for part in every]),
        labels=tuple(label for part in every for label in part.labels),
        scores=np.concatenate([part.scores for part in every]),
        covariances=np.concatenate(covariances) if are_known else None,
    )
