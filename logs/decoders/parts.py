"""What the encodings share: poses, frames and lists of detections, once their numbers are out of the message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from logs.messages import GeodeticFix, GroundTruthPose, ObjectDetections, Odometry, Record, SlamPose, Transform
from logs.topics import RecordKind
from logs.validation import LARGEST_M, FloatArray, Refusal, covariance_to_body, usable_covariance, usable_covariances

UNKNOWN_LABEL = "unknown"
"""Class of an object whose detector gave it none."""


def pose_record(
    kind: RecordKind, stamp_ns: int, frame_id: str, body_frame_id: str, T: FloatArray, covariance: FloatArray | None
) -> Record:
    """The record that a pose is on a topic of ``kind``; an empty frame name becomes the usual one."""
    if kind == RecordKind.ODOMETRY:
        return Odometry(stamp_ns, T, frame_id or "odom", body_frame_id or "base_link", covariance)
    if kind == RecordKind.GROUND_TRUTH:
        return GroundTruthPose(stamp_ns, T, frame_id or "world")
    return SlamPose(stamp_ns, T)


def frame_records(kind: RecordKind, frames: Iterable[tuple[int, str, str, FloatArray]]) -> tuple[Record, ...]:
    """Records of (stamp, parent, child, T_parent_child); as odometry, those whose parent is the frame "odom"."""
    if kind == RecordKind.ODOMETRY:
        return tuple(
            Odometry(stamp, T, parent, child) for stamp, parent, child, T in frames if parent.strip("/") == "odom"
        )
    return tuple(Transform(stamp, parent, child, T) for stamp, parent, child, T in frames)


def covariance_6x6(values: Sequence[float], T: FloatArray, counters: Counter[str]) -> FloatArray | None:
    """``(6, 6)`` in the records' form of the 36 numbers of ROS and Foxglove; None where unknown or unusable."""
    if len(values) == 0:
        return None
    if len(values) != 36:
        raise Refusal("lengths disagree", f"covariance of {len(values)} numbers, not 36")
    P = np.array(values, dtype=np.float64).reshape(6, 6)
    given = P.any(axis=0) | P.any(axis=1)
    if not given.all():
        # A robot on a plane leaves the rest at zero, which would mean that it is known exactly.
        if given.any():
            usable_covariance(P[np.ix_(given, given)], counters)
        return None
    usable = usable_covariance(P, counters)
    return None if usable is None else covariance_to_body(usable, T)


def fix_records(
    stamp_ns: int,
    frame_id: str,
    place: tuple[float, float, float],
    covariance: Sequence[float] | None,
    counters: Counter[str],
) -> tuple[Record, ...]:
    """The record of a latitude [deg], longitude [deg] and altitude [m], and of 9 numbers, None or zeros if unknown.

    An altitude that is NaN, as of a receiver that has none, is 0.
    """
    latitude, longitude, altitude_m = place
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise Refusal("no place on earth", f"latitude {latitude}, longitude {longitude}")
    if not abs(altitude_m) <= LARGEST_M:
        altitude_m = 0.0
    P = None if covariance is None else usable_covariance(np.array(covariance, np.float64).reshape(3, 3), counters)
    return (GeodeticFix(stamp_ns, frame_id, latitude, longitude, altitude_m, P),)


class DetectionList:
    """Gathers detections one by one, for messages that hold them so."""

    def __init__(self, stamp_ns: int, frame_id: str) -> None:
        self._stamp_ns = stamp_ns
        self._frame_id = frame_id
        self._positions: list[tuple[float, float, float]] = []
        self._labels: list[str] = []
        self._scores: list[float] = []
        self._covariances: list[FloatArray | None] = []
        self._sizes: list[tuple[float, float, float] | None] = []
        self._track_ids: list[str] = []

    def add(
        self,
        position: tuple[float, float, float],
        label: str,
        score: float,
        *,
        covariance: FloatArray | None = None,
        size: tuple[float, float, float] | None = None,
        track_id: str = "",
    ) -> None:
        """One object: position (3,) and size (3,) in metres, covariance (3, 3) in m^2."""
        self._positions.append(position)
        self._labels.append(label)
        self._scores.append(score)
        self._covariances.append(covariance)
        self._sizes.append(size)
        self._track_ids.append(track_id)

    def __len__(self) -> int:
        return len(self._labels)

    def record(self, counters: Counter[str]) -> ObjectDetections:
        """The record; sizes and track ids only where every object has them."""
        count = len(self._labels)
        sizes = [s for s in self._sizes if s is not None]
        return detections_record(
            self._stamp_ns,
            self._frame_id,
            np.array(self._positions, dtype=np.float64).reshape(count, 3),
            tuple(self._labels),
            np.array(self._scores, dtype=np.float64),
            np.array([np.zeros((3, 3)) if c is None else c for c in self._covariances]).reshape(count, 3, 3),
            np.array(sizes, dtype=np.float64) if sizes and len(sizes) == count else None,
            tuple(self._track_ids) if any(self._track_ids) else None,
            counters,
        )


class DetectionGroups:
    """Gathers detections by stamp and frame, for messages in which each object has its own."""

    def __init__(self) -> None:
        self._lists: dict[tuple[int, str], DetectionList] = {}

    def of(self, stamp_ns: int, frame_id: str) -> DetectionList:
        """Where the objects that were seen at ``stamp_ns`` in ``frame_id`` go."""
        return self._lists.setdefault((stamp_ns, frame_id), DetectionList(stamp_ns, frame_id))

    def records(self, counters: Counter[str]) -> tuple[ObjectDetections, ...]:
        """A record for each stamp and frame with objects, in the order in which they first came; else an empty one."""
        filled = [detections for detections in self._lists.values() if len(detections)]
        return tuple(detections.record(counters) for detections in filled or list(self._lists.values())[:1])


def detections_record(
    stamp_ns: int,
    frame_id: str,
    positions: FloatArray,
    labels: tuple[str, ...],
    scores: FloatArray,
    covariances: FloatArray | None,
    sizes: FloatArray | None,
    track_ids: tuple[str, ...] | None,
    counters: Counter[str],
) -> ObjectDetections:
    """The record of N detections, without those whose score is NaN or Inf, or position too, or absurdly far away
    ("dropped_objects").

    Scores are clipped to [0, 1]. Covariances that cannot weigh a measurement become zero, which means unknown
    ("ignored_covariances"), and None where none is known. So it is with sizes: NaN is unknown, absurd ones become NaN
    ("ignored_sizes").
    """
    with np.errstate(invalid="ignore"):
        good = (np.abs(positions) <= LARGEST_M).all(axis=1) & np.isfinite(scores)
    if not good.all():
        counters["dropped_objects"] += int((~good).sum())
        positions, scores = positions[good], scores[good]
        labels = tuple(label for label, keep in zip(labels, good, strict=True) if keep)
        covariances = None if covariances is None else covariances[good]
        sizes = None if sizes is None else sizes[good]
        track_ids = None if track_ids is None else tuple(t for t, keep in zip(track_ids, good, strict=True) if keep)
    if covariances is not None and len(covariances):
        covariances = usable_covariances(covariances, counters)
        covariances = covariances if covariances.any() else None
    if sizes is not None:
        infinite = np.abs(sizes) > LARGEST_M
        counters.update({"ignored_sizes": int(infinite.sum())} if infinite.any() else {})
        sizes = np.where(infinite, np.nan, sizes)
        sizes = None if np.isnan(sizes).all() else sizes
    return ObjectDetections(
        stamp_ns,
        frame_id,
        positions,
        tuple(label or UNKNOWN_LABEL for label in labels),
        np.clip(scores, 0.0, 1.0),
        covariances,
        sizes,
        track_ids,
    )
