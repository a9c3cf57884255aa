"""A whole log as a list of messages, and how faults read and change it.

A fault never changes its argument: it returns a new list. The true ids of detections follow the detections, for a truth
is found by their stamp; true poses and true objects stay as they are.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Odometry, Record, Transform
from logs.topics import RawMessage
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, interpolate
from slam.frontend.input.sensor_frames import SensorFrames

HALF = 0.5
"""Faults that set in at some time do so at this part of the time of the drive, unless a parameter says when."""


class Entry(NamedTuple):
    """One message: a record, or as it was read where it is of a topic that no fault looks at.

    ``raw``: the message that ``content`` was decoded from; None where it differs from that. ``number``: of the message
    in the log, which orders those of equal log time.
    """

    topic: str
    log_time_ns: int
    content: Record | RawMessage
    raw: RawMessage | None = None
    number: int = 0

    @property
    def stamp_ns(self) -> int:
        """Stamp of the record."""
        return int(getattr(self.content, "stamp_ns"))  # noqa: B009  of a raw message nobody asks

    def having(self, content: Record, log_time_ns: int | None = None) -> Entry:
        """The message with another content."""
        return Entry(self.topic, self.log_time_ns if log_time_ns is None else log_time_ns, content, number=self.number)

    def with_fields(self, log_time_ns: int | None = None, **fields: Any) -> Entry:
        """The message with other fields of its record."""
        return self.having(replace(cast(Any, self.content), **fields), log_time_ns)


Stream = Sequence[Entry]


def seconds_ns(seconds: float) -> int:
    """Whole nanoseconds."""
    return round(seconds * 1e9)


def span_ns(stream: Stream) -> tuple[int, int]:
    """First and last stamp of odometry and detections.

    Raises:
        SimulationError: there is neither.
    """
    stamps = [e.content.stamp_ns for e in stream if isinstance(e.content, (Odometry, ObjectDetections))]
    if not stamps:
        raise SimulationError("the log holds neither odometry nor detections, so no fault can be applied")
    return min(stamps), max(stamps)


def stamp_at(stream: Stream, fraction: float) -> int:
    """The stamp at a part of the time of the drive, in [0, 1]."""
    first_ns, last_ns = span_ns(stream)
    return first_ns + round(fraction * (last_ns - first_ns))


def span_from_half(stream: Stream, seconds: float) -> tuple[int, int]:
    """The stamp at half the time of the drive, and so long after it."""
    begin_ns = stamp_at(stream, HALF)
    return begin_ns, begin_ns + seconds_ns(seconds)


def odometry_of(stream: Stream) -> tuple[IntArray, FloatArray]:
    """Stamps (N,) and poses T_odom_body (N, 4, 4) of the odometry, in the order of the log.

    Raises:
        SimulationError: the log holds no odometry.
    """
    found = [e.content for e in stream if isinstance(e.content, Odometry)]
    if not found:
        raise SimulationError("the log holds no odometry, which this fault needs")
    stamps = np.array([o.stamp_ns for o in found], dtype=np.int64)
    return stamps, np.array([o.T_odom_body for o in found])


def true_poses_at(stream: Stream, stamps_ns: IntArray) -> FloatArray:
    """True poses T_world_body (N, 4, 4) at the stamps (N,), those of the ends outside of the truth.

    Raises:
        SimulationError: there is no true pose.
    """
    found = [e.content for e in stream if isinstance(e.content, GroundTruthPose)]
    if not found:
        raise SimulationError("the log holds no true poses, which this fault needs: record /ground_truth")
    return poses_at(
        np.array([p.stamp_ns for p in found], dtype=np.int64), np.array([p.T_world_body for p in found]), stamps_ns
    )


def odometry_at(stream: Stream, stamps_ns: IntArray) -> FloatArray:
    """Poses T_odom_body (N, 4, 4) at the stamps (N,), those of the ends outside of the odometry."""
    return poses_at(*odometry_of(stream), stamps_ns)


def poses_at(stamps_ns: IntArray, T_a_b: FloatArray, at_ns: IntArray) -> FloatArray:
    """Poses (M, 4, 4) at ``at_ns`` (M,) of the poses (N, 4, 4) at ``stamps_ns`` (N,) in any order; the first and the
    last one outside of their span.
    """
    ordered, first = np.unique(stamps_ns, return_index=True)
    return interpolate(ordered, T_a_b[first], np.clip(at_ns, ordered[0], ordered[-1]))


def body_frames_of(stream: Stream) -> Callable[[str], FloatArray]:
    """A function from a sensor's frame to T_body_sensor (4, 4); the identity without a transform."""
    frames, body = SensorFrames(), "base_link"
    for entry in stream:
        if isinstance(entry.content, Transform):
            frames.add(entry.content)
    for entry in stream:
        if isinstance(entry.content, Odometry):
            body = entry.content.child_frame_id
            break

    def T_body_sensor(frame: str) -> FloatArray:
        found = None if frame in ("", body) else frames.find(body, frame)
        return np.eye(4) if found is None else found

    return T_body_sensor


def bearing_frames_of(stream: Stream) -> Callable[[str], FloatArray]:
    """As :func:`body_frames_of`, where it matters from which place an object was seen.

    Raises:
        SimulationError: detections are in the frame of the odometry.
    """
    odometry = next((e.content for e in stream if isinstance(e.content, Odometry)), None)
    frames = {e.content.frame_id for e in stream if isinstance(e.content, ObjectDetections)}
    if odometry is not None and odometry.frame_id in frames - {"", odometry.child_frame_id}:
        raise SimulationError(
            f"detections are in {odometry.frame_id!r}, the frame of the odometry, which gives neither their range nor "
            "their bearing: record them in a sensor's frame"
        )
    return body_frames_of(stream)


def alter_detections(stream: Stream, alter: Callable[[ObjectDetections], ObjectDetections]) -> list[Entry]:
    """The stream with each message of detections altered, which keeps their number and their stamp."""
    return [e.having(alter(e.content)) if isinstance(e.content, ObjectDetections) else e for e in stream]


def restamp_scans(stream: Stream, new_stamp_ns: Callable[[int], int]) -> list[Entry]:
    """The stream with other stamps of detections and their true ids, without those whose stamp would be before zero."""
    found = []
    for e in stream:
        if isinstance(e.content, (ObjectDetections, DetectionTruth)):
            stamp_ns = new_stamp_ns(e.content.stamp_ns)
            changed = e if stamp_ns == e.content.stamp_ns else e.with_fields(stamp_ns=stamp_ns)
            found += [changed] if stamp_ns >= 0 else []
        else:
            found.append(e)
    return found


def keep_scans(stream: Stream, is_kept: Callable[[int], bool]) -> list[Entry]:
    """The stream without the detections, and their true ids, of the stamps that are not kept."""
    return [
        e
        for e in stream
        if not isinstance(e.content, (ObjectDetections, DetectionTruth)) or is_kept(e.content.stamp_ns)
    ]


class Scan(NamedTuple):
    """Detections and where their message and that of their truth, if there is one, stand in the stream."""

    row: int
    detections: ObjectDetections
    truth_row: int | None
    object_ids: tuple[str, ...] | None

    @property
    def stamp_ns(self) -> int:
        """Stamp of the detections."""
        return self.detections.stamp_ns

    def with_fields(self, **fields: Any) -> Scan:
        """The scan with other fields of its detections."""
        return self._replace(detections=replace(self.detections, **fields))


def scans_of(stream: Stream) -> list[Scan]:
    """All messages of detections with the true ids, None where the log has none of that stamp and number."""
    truths: defaultdict[int, deque[tuple[int, DetectionTruth]]] = defaultdict(deque)
    for row, entry in enumerate(stream):
        if isinstance(entry.content, DetectionTruth):
            truths[entry.content.stamp_ns].append((row, entry.content))
    found = []
    for row, entry in enumerate(stream):
        detections = entry.content
        if isinstance(detections, ObjectDetections):
            waiting = truths.get(detections.stamp_ns)
            truth_row, truth = waiting.popleft() if waiting else (None, None)
            fits = truth is not None and len(truth.object_ids) == len(detections.labels)
            found.append(Scan(row, detections, truth_row, truth.object_ids if truth is not None and fits else None))
    return found


def scans_with_ids(stream: Stream) -> list[Scan]:
    """The messages of detections that have true ids.

    Raises:
        SimulationError: there is none.
    """
    scans = [scan for scan in scans_of(stream) if scan.object_ids is not None]
    if not scans:
        raise SimulationError(
            "the log holds no true ids of its detections (/ground_truth/detections), which this fault needs"
        )
    return scans


def replace_scans(stream: Stream, changed: Iterable[Scan]) -> list[Entry]:
    """The stream with the detections and true ids of ``changed`` at their rows.

    True ids that did not fit their detections before are left out.
    """
    result: list[Entry | None] = list(stream)
    for scan in changed:
        result[scan.row] = stream[scan.row].having(scan.detections)
        if scan.truth_row is None:
            continue
        before = stream[scan.truth_row]
        if scan.object_ids is None:
            result[scan.truth_row] = None
        elif isinstance(before.content, DetectionTruth) and scan.object_ids != before.content.object_ids:
            result[scan.truth_row] = before.having(DetectionTruth(scan.detections.stamp_ns, scan.object_ids))
    return [entry for entry in result if entry is not None]


def select_detections(detections: ObjectDetections, rows: NDArray[np.bool_] | IntArray) -> ObjectDetections:
    """The detections ``rows``, a mask (N,) or row numbers (M,)."""
    numbers = np.arange(len(detections.labels))[rows]
    ids = detections.track_ids
    return replace(
        detections,
        positions=detections.positions[numbers],
        labels=tuple(detections.labels[i] for i in numbers),
        scores=detections.scores[numbers],
        covariances=None if detections.covariances is None else detections.covariances[numbers],
        sizes=None if detections.sizes is None else detections.sizes[numbers],
        track_ids=None if ids is None else tuple(ids[i] for i in numbers),
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


def by_log_time(entries: Iterable[Entry]) -> list[Entry]:
    """The entries in the order of log time; those of equal time keep theirs."""
    return sorted(entries, key=lambda entry: entry.log_time_ns)


def labels_of(stream: Stream) -> list[str]:
    """All labels of the detections, sorted."""
    return sorted({label for e in stream if isinstance(e.content, ObjectDetections) for label in e.content.labels})
