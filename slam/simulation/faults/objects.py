"""Faults of which objects there are: none, too many, two, or such as move."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from logs.messages import ObjectDetections
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert
from slam.simulation.degradation import join_detections, select_detections
from slam.simulation.faults.stream import (
    HALF,
    Entry,
    Scan,
    Stream,
    body_frames_of,
    keep_scans,
    labels_of,
    odometry_at,
    replace_scans,
    scans_of,
    seconds_ns,
    stamp_at,
)

_BURST_RADIUS_M = 60.0
_IN_VIEW_AGAIN_NS = 10_000_000_000
"""An object that was not seen for so long has gone elsewhere when it comes back."""


def stop_detecting(stream: Stream, rng: np.random.Generator, fraction: float) -> list[Entry]:
    """From a part of the drive on, no detections come."""
    begin_ns = stamp_at(stream, fraction)
    return keep_scans(stream, lambda stamp_ns: stamp_ns < begin_ns)


def repeat_scan(stream: Stream, rng: np.random.Generator, seconds: float) -> list[Entry]:
    """From the half on, each scan repeats the objects of the last one before, for a while."""
    begin_ns = stamp_at(stream, HALF)
    end_ns = begin_ns + seconds_ns(seconds)
    changed: list[Scan] = []
    last: Scan | None = None
    for scan in scans_of(stream):
        stamp_ns = scan.detections.stamp_ns
        if last is not None and begin_ns <= stamp_ns < end_ns:
            changed.append(
                scan._replace(detections=replace(last.detections, stamp_ns=stamp_ns), object_ids=last.object_ids)
            )
        else:
            last = scan
    return replace_scans(stream, changed)


def burst(stream: Stream, rng: np.random.Generator, count: float, seconds: float) -> list[Entry]:
    """For a while from the half on, so many more objects stand around, of the log's classes, each in every scan."""
    begin_ns = stamp_at(stream, HALF)
    end_ns = begin_ns + seconds_ns(seconds)
    labels, frame = labels_of(stream) or ["object"], body_frames_of(stream)
    T_odom_begin = odometry_at(stream, np.array([begin_ns], dtype=np.int64))[0]
    radius_m = _BURST_RADIUS_M * np.sqrt(rng.random(int(count)))
    angle_rad = rng.uniform(-np.pi, np.pi, int(count))
    around = np.column_stack([radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad), np.zeros(int(count))])
    standing = apply(T_odom_begin, around)
    of_class = tuple(labels[i] for i in rng.integers(len(labels), size=int(count)))
    scans = [s for s in scans_of(stream) if begin_ns <= s.detections.stamp_ns < end_ns]
    T_odom_bodies = odometry_at(stream, np.array([scan.detections.stamp_ns for scan in scans], dtype=np.int64))
    changed = []
    for scan, T_odom_body in zip(scans, T_odom_bodies, strict=True):
        positions = apply(invert(T_odom_body @ frame(scan.detections.frame_id)), standing)
        more = ObjectDetections(
            scan.detections.stamp_ns, scan.detections.frame_id, positions, of_class, np.ones(int(count))
        )
        ids = None if scan.object_ids is None else scan.object_ids + ("",) * int(count)
        changed.append(scan._replace(detections=join_detections(scan.detections, more), object_ids=ids))
    return replace_scans(stream, changed)


def keep_objects(stream: Stream, rng: np.random.Generator, count: float) -> list[Entry]:
    """All but the objects that are seen most often are missing; other scans are empty."""
    scans = _scans_with_ids(stream)
    seen = Counter(i for scan in scans for i in scan.object_ids or () if i)
    kept = {i for i, _ in sorted(seen.items(), key=lambda item: (-item[1], item[0]))[: int(count)]}
    changed = []
    for scan in scans:
        ids = scan.object_ids or ()
        rows = np.array([i in kept for i in ids], dtype=np.bool_)
        left = select_detections(scan.detections, rows)
        changed.append(scan._replace(detections=left, object_ids=tuple(i for i in ids if i in kept)))
    return replace_scans(stream, changed)


def move_objects(stream: Stream, rng: np.random.Generator, share: float, speed_m_s: float) -> list[Entry]:
    """A share of the objects moves: each time it comes into view, straight on in a direction taken at random."""
    scans = sorted(_scans_with_ids(stream), key=lambda scan: scan.detections.stamp_ns)
    objects = sorted({i for scan in scans for i in scan.object_ids or () if i})
    drawn = rng.random(len(objects))
    moving = {i for i, number in zip(objects, drawn, strict=True) if number < share}
    frame = body_frames_of(stream)
    stamps_ns = np.array([scan.detections.stamp_ns for scan in scans], dtype=np.int64)
    passes: dict[str, tuple[int, int, FloatArray]] = {}  # when it came, when it was seen last, which way it goes
    changed = []
    for scan, T_odom_body in zip(scans, odometry_at(stream, stamps_ns), strict=True):
        stamp_ns, positions = scan.detections.stamp_ns, scan.detections.positions.copy()
        R_sensor_odom = (T_odom_body @ frame(scan.detections.frame_id))[:3, :3].T
        for row, name in enumerate(scan.object_ids or ()):
            if name not in moving:
                continue
            came_ns, seen_ns, direction = passes.get(name, (0, -_IN_VIEW_AGAIN_NS, np.zeros(3)))
            if stamp_ns - seen_ns >= _IN_VIEW_AGAIN_NS:
                angle_rad = rng.uniform(-np.pi, np.pi)
                came_ns, direction = stamp_ns, np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
            passes[name] = (came_ns, stamp_ns, direction)
            positions[row] += R_sensor_odom @ direction * speed_m_s * (stamp_ns - came_ns) * 1e-9
        changed.append(scan._replace(detections=replace(scan.detections, positions=positions), truth_row=None))
    return replace_scans(stream, changed)


def _scans_with_ids(stream: Stream) -> list[Scan]:
    scans = [scan for scan in scans_of(stream) if scan.object_ids is not None]
    if not scans:
        raise SimulationError(
            "the log holds no true ids of its detections (/ground_truth/detections), by which this fault tells objects"
        )
    return scans
