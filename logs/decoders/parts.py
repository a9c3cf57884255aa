"""What the encodings share: poses, frames, fixes and detections, once their numbers are out of the message."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from logs.dslam_codec import take_rows
from logs.messages import GeodeticFix, GroundTruthPose, ObjectDetections, Odometry, Record, SlamPose, Transform
from logs.topics import RawMessage, RecordKind
from logs.validation import (
    MAX_COORDINATE_M,
    FloatArray,
    Refusal,
    flat_array,
    stamp_ns,
    transform_of,
    usable_covariance,
    usable_covariances,
)

UNKNOWN_LABEL = "unknown"
"""Class of an object whose detector gave it none."""

Records = tuple[Record, ...]
Place = tuple[int, str]
"""Stamp [ns] and frame."""

DETECTIONS = (RecordKind.DETECTIONS,)
POSE = (RecordKind.ODOMETRY, RecordKind.GROUND_TRUTH)
FRAMES = (RecordKind.TRANSFORMS, RecordKind.ODOMETRY)
"""What a pose, and the pose of a frame in another, may be on a topic."""


class Context(NamedTuple):
    """A message, the part that its topic plays, and counts of what is left out of records that are otherwise good."""

    raw: RawMessage
    kind: RecordKind
    counters: Counter[str]


class MessageDecoder(NamedTuple):
    """The parts that a topic with messages of a schema may play, and what makes records of such a message."""

    kinds: tuple[RecordKind, ...]
    records: Callable[[Any, Context], Records]
    message_class: Any = None
    """Of protobuf; None of ROS."""


class Detection(NamedTuple):
    """One object: position (3,) m, covariance (3, 3) m^2, zeros where it is unknown."""

    position: tuple[float, float, float]
    label: str
    score: float = 1.0
    covariance: FloatArray = np.zeros((3, 3))


def xyz(vector: Any) -> tuple[float, float, float]:
    """The three numbers of a point or vector."""
    return vector.x, vector.y, vector.z


def place_of(message: Any, context: Context, otherwise: Place | None = None) -> Place:
    """Stamp and frame of a message, as its ROS header or its own fields have them; where they are empty, those of
    ``otherwise``, or the log time.
    """
    time_ns, frame = otherwise or (context.raw.log_time_ns, "")
    header = getattr(message, "header", None)
    if header is not None:
        return stamp_ns(header.stamp.sec, header.stamp.nanosec, time_ns), header.frame_id or frame
    named = message.frame_id if hasattr(message, "frame_id") else message.parent_frame_id
    return stamp_ns(message.timestamp.seconds, message.timestamp.nanos, time_ns), named or frame


def pose_decoder(path: str, body: str = "") -> Callable[[Any, Context], Records]:
    """What makes of a message the record that its pose, at a ``path`` of fields, is on a topic of its kind.

    ``body``: the field with the name of the body. An empty name of a frame becomes the usual one.
    """
    pose_of = attrgetter(path)

    def decode(message: Any, context: Context) -> Records:
        time_ns, frame_id = place_of(message, context)
        pose = pose_of(message)
        T = transform_of(pose.position, pose.orientation)
        if context.kind == RecordKind.ODOMETRY:
            return (Odometry(time_ns, T, frame_id or "odom", (body and getattr(message, body)) or "base_link"),)
        if context.kind == RecordKind.GROUND_TRUTH:
            return (GroundTruthPose(time_ns, T, frame_id or "world"),)
        return (SlamPose(time_ns, T),)

    return decode


def frame_records(message: Any, context: Context) -> Records:
    """The frames in a message of several, or of one: as transforms, or, as odometry, those whose parent is "odom"."""
    records = list[Record]()
    for frame in getattr(message, "transforms", [message]):
        time_ns, parent = place_of(frame, context)
        placed = getattr(frame, "transform", frame)
        T = transform_of(placed.translation, placed.rotation)
        if context.kind == RecordKind.TRANSFORMS:
            records.append(Transform(time_ns, parent, frame.child_frame_id, T))
        elif parent.strip("/") == "odom":
            records.append(Odometry(time_ns, T, parent, frame.child_frame_id))
    return tuple(records)


def fix_records(message: Any, context: Context) -> Records:
    """The record of a fix: latitude and longitude [deg], altitude [m], 9 numbers of a covariance and how it is known.

    An altitude that is NaN, as of a receiver that has none, is 0. None of a receiver that says that it has no fix.
    """
    if hasattr(message, "status") and message.status.status < 0:
        return ()
    latitude, longitude, altitude_m = message.latitude, message.longitude, message.altitude
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise Refusal("not a valid latitude and longitude", f"latitude {latitude}, longitude {longitude}")
    P = None
    if message.position_covariance_type:
        P = usable_covariance(flat_array(message.position_covariance, (3, 3), "covariance"), context.counters)
    place = place_of(message, context)
    return (GeodeticFix(*place, latitude, longitude, altitude_m if abs(altitude_m) <= MAX_COORDINATE_M else 0.0, P),)


def detection_records(scans: Mapping[Place, Sequence[Detection]], counters: Counter[str]) -> Records:
    """A record for each stamp and frame with objects, in their order; without any object, an empty one of the first."""
    filled = {place: found for place, found in scans.items() if found} or dict(list(scans.items())[:1])
    records = (
        ObjectDetections(
            *place,
            np.array([each.position for each in found], dtype=np.float64).reshape(-1, 3),
            tuple(each.label for each in found),
            np.array([each.score for each in found], dtype=np.float64),
            np.array([each.covariance for each in found]).reshape(-1, 3, 3),
        )
        for place, found in filled.items()
    )
    return tuple(usable_detections(record, counters) for record in records)


def usable_detections(record: ObjectDetections, counters: Counter[str]) -> ObjectDetections:
    """The detections without those whose score or position is not finite, or that are absurdly far away
    ("dropped_objects").

    Scores are clipped to [0, 1]. Covariances that cannot weigh a measurement become zero, which means unknown
    ("ignored_covariances"), and None where none is known.
    """
    good = (np.abs(record.positions).max(axis=1) <= MAX_COORDINATE_M) & np.isfinite(record.scores)
    if not good.all():
        counters["dropped_objects"] += int((~good).sum())
        record = take_rows(record, N=np.flatnonzero(good))
    covariances = record.covariances
    if covariances is not None:
        covariances = usable_covariances(covariances, counters)
        covariances = covariances if covariances.any() else None
    labels = tuple(label or UNKNOWN_LABEL for label in record.labels)
    scores = np.minimum(np.maximum(record.scores, 0.0), 1.0)
    return ObjectDetections(record.stamp_ns, record.frame_id, record.positions, labels, scores, covariances)
