"""Faults of which objects there are: none, too many, two, or such as move."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Annotated

import numpy as np

from logs.messages import ObjectDetections
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert
from slam.simulation.faults.fault import (
    DETECTIONS,
    ODOMETRY,
    SCANS,
    TRANSFORMS,
    Duration,
    Number,
    Part,
    Range,
    Share,
    fault,
)
from slam.simulation.faults.stream import (
    Entry,
    Scan,
    Stream,
    body_frames_of,
    join_detections,
    keep_scans,
    labels_of,
    odometry_at,
    replace_scans,
    scans_of,
    scans_with_ids,
    select_detections,
    span_from_half,
    stamp_at,
)

_BURST_RADIUS_M = 60.0
_Speed = Annotated[float, Range("m/s", max=1e3)]
_IN_VIEW_AGAIN_NS = 10_000_000_000
"""An object that was not seen for so long has gone elsewhere when it comes back."""


@fault(SCANS, reads=ODOMETRY)
def detections_stop(stream: Stream, fraction: Part = 0.5) -> list[Entry]:
    """No detections come from a part of the drive on."""
    begin_ns = stamp_at(stream, fraction)
    return keep_scans(stream, lambda stamp_ns: stamp_ns < begin_ns)


@fault(SCANS, reads=ODOMETRY)
def scan_repeated(stream: Stream, seconds: Duration = 10.0) -> list[Entry]:
    """The last scan before half time is repeated for S."""
    begin_ns, end_ns = span_from_half(stream, seconds)
    changed: list[Scan] = []
    last: Scan | None = None
    for scan in scans_of(stream):
        if last is not None and begin_ns <= scan.stamp_ns < end_ns:
            repeated = replace(last.detections, stamp_ns=scan.stamp_ns)
            changed.append(scan._replace(detections=repeated, object_ids=last.object_ids))
        else:
            last = scan
    return replace_scans(stream, changed)


@fault(SCANS, reads=(*ODOMETRY, *TRANSFORMS))
def objects_burst(
    stream: Stream, count: Number = 5000.0, seconds: Duration = 3.0, *, rng: np.random.Generator
) -> list[Entry]:
    """NUMBER more objects of the classes of the log appear for S from half time on."""
    begin_ns, end_ns = span_from_half(stream, seconds)
    labels, frame = labels_of(stream) or ["object"], body_frames_of(stream)
    T_odom_begin = odometry_at(stream, np.array([begin_ns], dtype=np.int64))[0]
    radius_m = _BURST_RADIUS_M * np.sqrt(rng.random(int(count)))
    angle_rad = rng.uniform(-np.pi, np.pi, int(count))
    around = np.column_stack([radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad), np.zeros(int(count))])
    standing = apply(T_odom_begin, around)
    of_class = tuple(labels[i] for i in rng.integers(len(labels), size=int(count)))
    scans = [s for s in scans_of(stream) if begin_ns <= s.stamp_ns < end_ns]
    T_odom_bodies = odometry_at(stream, np.array([scan.stamp_ns for scan in scans], dtype=np.int64))
    changed = []
    for scan, T_odom_body in zip(scans, T_odom_bodies, strict=True):
        positions = apply(invert(T_odom_body @ frame(scan.detections.frame_id)), standing)
        more = ObjectDetections(scan.stamp_ns, scan.detections.frame_id, positions, of_class, np.ones(int(count)))
        ids = None if scan.object_ids is None else scan.object_ids + ("",) * int(count)
        changed.append(scan._replace(detections=join_detections(scan.detections, more), object_ids=ids))
    return replace_scans(stream, changed)


@fault(SCANS)
def objects_few(stream: Stream, count: Number = 2.0) -> list[Entry]:
    """Only the NUMBER objects that are seen most often remain."""
    scans = scans_with_ids(stream)
    seen = Counter(i for scan in scans for i in scan.object_ids or () if i)
    kept = {i for i, _ in sorted(seen.items(), key=lambda item: (-item[1], item[0]))[: int(count)]}
    changed = []
    for scan in scans:
        ids = scan.object_ids or ()
        rows = np.array([i in kept for i in ids], dtype=np.bool_)
        left = select_detections(scan.detections, rows)
        changed.append(scan._replace(detections=left, object_ids=tuple(i for i in ids if i in kept)))
    return replace_scans(stream, changed)


@fault(DETECTIONS, reads=(*ODOMETRY, *SCANS, *TRANSFORMS))
def objects_moving(
    stream: Stream, share: Share = 0.5, speed_m_s: _Speed = 2.0, *, rng: np.random.Generator
) -> list[Entry]:
    """A share of the objects moves by M/S.

    Each time an object comes into view it moves straight on in a direction drawn at random.
    """
    scans = sorted(scans_with_ids(stream), key=lambda scan: scan.stamp_ns)
    objects = sorted({i for scan in scans for i in scan.object_ids or () if i})
    drawn = rng.random(len(objects))
    moving = {i for i, number in zip(objects, drawn, strict=True) if number < share}
    frame = body_frames_of(stream)
    stamps_ns = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    passes: dict[str, tuple[int, int, FloatArray]] = {}  # when it came, when it was seen last, which way it goes
    changed = []
    for scan, T_odom_body in zip(scans, odometry_at(stream, stamps_ns), strict=True):
        stamp_ns, positions = scan.stamp_ns, scan.detections.positions.copy()
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
        changed.append(scan.with_fields(positions=positions))
    return replace_scans(stream, changed)
