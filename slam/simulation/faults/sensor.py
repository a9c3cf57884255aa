"""What a worse sensor misses, measures and invents, and a drive that is played backwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import compress
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Odometry, Transform
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.simulation.faults.fault import (
    DETECTIONS,
    EVERYTHING,
    ODOMETRY,
    SCANS,
    TRANSFORMS,
    Range,
    Share,
    Sigma,
    detection_fault,
    fault,
)
from slam.simulation.faults.stream import (
    Entry,
    Stream,
    alter_detections,
    bearing_frames_of,
    by_log_time,
    join_detections,
    labels_of,
    replace_scans,
    scans_of,
    select_detections,
    span_ns,
)

FALSE_POSITIVE_RANGE_PERCENTILE = 95.0
"""False positives lie within the range that holds so many per cent of the log's detections."""
_UNCHANGED = 1e-9  # transforms that differ by no more are the same

_Angle = Annotated[float, Range("deg", min=1e-9, max=360.0)]
_Reach = Annotated[float, Range("m", min=1e-9)]
_PerScan = Annotated[float, Range("number", max=1000.0)]


@fault(EVERYTHING, keeps_others=False, name="reversed")
def play_backwards(stream: Stream) -> list[Entry]:
    """The drive is played backwards, in reverse gear; topics that cannot be reversed are left out."""
    first_ns, last_ns = span_ns(stream)
    moving = _moving_frames(stream)
    reversible = (Odometry, ObjectDetections, DetectionTruth, GroundTruthPose)
    found = []
    for entry in stream:
        record = entry.content
        if isinstance(record, reversible) or (isinstance(record, Transform) and _frames(record) in moving):
            stamp_ns = max(first_ns + last_ns - record.stamp_ns, 0)
            delay_ns = entry.log_time_ns - record.stamp_ns
            entry = entry.having(replace(record, stamp_ns=stamp_ns), max(stamp_ns + delay_ns, 0))
        found.append(entry)
    return by_log_time(found)


@detection_fault(neutral=0.0)
def position_noise(seen: ObjectDetections, sigma_m: Sigma = 1.0, *, rng: np.random.Generator) -> ObjectDetections:
    """Positions have M more noise on each axis, and known covariances contain it."""
    covariances = seen.covariances
    if covariances is not None:
        is_known = np.any(covariances != 0.0, axis=(1, 2))
        covariances = covariances + (is_known * sigma_m**2)[:, None, None] * np.eye(3)
    noise = sigma_m * rng.standard_normal(seen.positions.shape)
    return replace(seen, positions=seen.positions + noise, covariances=covariances)


@fault(SCANS, neutral=0.0)
def dropout(stream: Stream, probability: Share = 0.3, *, rng: np.random.Generator) -> list[Entry]:
    """Each detection is lost with a probability."""
    return _selected(stream, lambda detections: rng.random(len(detections.labels)) >= probability)


@fault(SCANS, reads=(*ODOMETRY, *TRANSFORMS), neutral=360.0)
def field_of_view(stream: Stream, angle_deg: _Angle = 180.0) -> list[Entry]:
    """The sensor has a field of view of DEG, centred ahead."""
    from_sensor = _from_sensor(stream)

    def is_ahead(detections: ObjectDetections) -> NDArray[np.bool_]:
        x, y, _ = from_sensor(detections).T
        return np.asarray(np.abs(np.arctan2(y, x)) <= 0.5 * np.deg2rad(angle_deg))

    return _selected(stream, is_ahead)


@fault(SCANS, reads=(*ODOMETRY, *TRANSFORMS))
def max_range(stream: Stream, range_m: _Reach = 20.0) -> list[Entry]:
    """The sensor has a horizontal range of M."""
    from_sensor = _from_sensor(stream)
    return _selected(stream, lambda detections: np.linalg.norm(from_sensor(detections)[:, :2], axis=1) <= range_m)


@fault(SCANS)
def keep_label(stream: Stream, *labels: str) -> list[Entry]:
    """Only objects of these classes are detected."""
    _refuse_unknown(stream, labels)
    return _selected(stream, lambda detections: np.isin(detections.labels, labels))


@fault(SCANS)
def drop_label(stream: Stream, *labels: str) -> list[Entry]:
    """Objects of these classes are not detected."""
    _refuse_unknown(stream, labels)
    if set(labels_of(stream)) == set(labels):
        raise SimulationError(f"no label is left; the labels of the log are {', '.join(labels_of(stream))}")
    return _selected(stream, lambda detections: ~np.isin(detections.labels, labels))


@fault(DETECTIONS, neutral=0.0)
def label_confusion(stream: Stream, probability: Share = 0.5, *, rng: np.random.Generator) -> list[Entry]:
    """Each label is replaced by another of the log with a probability."""
    labels = np.array(labels_of(stream))
    if len(labels) == 1:
        raise SimulationError(f"{labels[0]!r} is the only label and cannot be confused with another")

    def alter(detections: ObjectDetections) -> ObjectDetections:
        rows = np.searchsorted(labels, np.array(detections.labels, dtype=labels.dtype))
        is_confused = rng.random(len(rows)) < probability
        others = (rows + rng.integers(1, max(len(labels), 2), size=len(rows))) % max(len(labels), 1)
        return replace(detections, labels=tuple(labels[np.where(is_confused, others, rows)].tolist()))

    return alter_detections(stream, alter)


@fault(SCANS, reads=(*ODOMETRY, *TRANSFORMS), neutral=0.0)
def false_positives(stream: Stream, mean: _PerScan = 10.0, *, rng: np.random.Generator) -> list[Entry]:
    """NUMBER false objects a scan are added on average.

    They are evenly spread over the range and the bearings of the log's detections, and have heights, labels, scores,
    sizes and covariances of detections drawn from the log.
    """
    from_sensor, R_body_sensor = _from_sensor(stream), bearing_frames_of(stream)
    scans = scans_of(stream)
    seen = [replace(scan.detections, positions=from_sensor(scan.detections)) for scan in scans]
    if not any(each.labels for each in seen):
        raise SimulationError("no detection is in view, so false positives cannot be modelled; widen the field of view")
    donors = join_detections(*seen)
    x, y, _ = donors.positions.T
    reach_m = np.percentile(np.hypot(x, y), FALSE_POSITIVE_RANGE_PERCENTILE)
    bearings = np.arctan2(y, x)
    changed = []
    for scan in scans:
        count = int(rng.poisson(mean))
        range_m, bearing = reach_m * np.sqrt(rng.random(count)), rng.uniform(bearings.min(), bearings.max(), count)
        false = select_detections(donors, rng.integers(len(donors.labels), size=count))
        xyz = np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing), false.positions[:, 2]], axis=1)
        R = R_body_sensor(scan.detections.frame_id)[:3, :3]
        false = replace(false, positions=xyz @ R, track_ids=None)
        ids = None if scan.object_ids is None else scan.object_ids + ("",) * count
        changed.append(scan._replace(detections=join_detections(scan.detections, false), object_ids=ids))
    return replace_scans(stream, changed)


def _selected(stream: Stream, choose: Callable[[ObjectDetections], NDArray[np.bool_]]) -> list[Entry]:
    """The stream with the detections that are chosen, and their true ids."""
    changed = []
    for scan in scans_of(stream):
        kept = choose(scan.detections)
        ids = None if scan.object_ids is None else tuple(compress(scan.object_ids, kept))
        changed.append(scan._replace(detections=select_detections(scan.detections, kept), object_ids=ids))
    return replace_scans(stream, changed)


def _from_sensor(stream: Stream) -> Callable[[ObjectDetections], FloatArray]:
    """A function to positions (N, 3), metres, from the sensor in the axes of the body."""
    T_body_sensor = bearing_frames_of(stream)
    return lambda detections: detections.positions @ T_body_sensor(detections.frame_id)[:3, :3].T


def _refuse_unknown(stream: Stream, labels: tuple[str, ...]) -> None:
    known = labels_of(stream)
    for label in labels:
        if label not in known:
            raise SimulationError(f"no detection is labelled {label!r}; the labels of the log are {', '.join(known)}")


def _frames(transform: Transform) -> tuple[str, str]:
    return transform.parent_frame_id, transform.child_frame_id


def _moving_frames(stream: Stream) -> set[tuple[str, str]]:
    """Frames (parent, child) whose transform changes."""
    first: dict[tuple[str, str], FloatArray] = {}
    moving = set[tuple[str, str]]()
    for entry in stream:
        if isinstance(entry.content, Transform):
            known = first.setdefault(_frames(entry.content), entry.content.T_parent_child)
            if np.abs(known - entry.content.T_parent_child).max() > _UNCHANGED:
                moving.add(_frames(entry.content))
    return moving
