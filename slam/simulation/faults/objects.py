"""Faults of the drive as a whole: no objects, too many, such as move, another unit of length, time backwards."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from logs.messages import ObjectDetections, Transform
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert
from slam.simulation.faults.fault import Duration, Number, Part, Share, fault
from slam.simulation.faults.recording import Message, Recording, Scan, by_log_time

_Speed = Annotated[float, Field(ge=0.0, le=1e3, description="m/s")]
_LengthFactor = Annotated[float, Field(ge=1e-6, le=1e6, description="factor")]
_BURST_RADIUS_M = 60.0
_IN_VIEW_AGAIN_NS = 10_000_000_000
"""An object that was not seen for so long has gone elsewhere when it comes back."""


@fault()
def detections_stop(log: Recording, fraction: Part = 0.5) -> Recording:
    """No detections come from a part of the drive on."""
    begin_ns = log.stamp_at(fraction)
    return log.select_scans(lambda stamp_ns: stamp_ns < begin_ns)


@fault()
def scan_repeated(log: Recording, seconds: Duration = 10.0) -> Recording:
    """The last scan before the middle of the drive is repeated for S."""
    begin_ns, end_ns = log.from_half(seconds)
    changed: list[Scan] = []
    last: Scan | None = None
    for scan in log.scans:
        if last is not None and begin_ns <= scan.stamp_ns < end_ns:
            changed.append(scan.having(replace(last.detections, stamp_ns=scan.stamp_ns), last.ids))
        else:
            changed.append(scan)
            last = scan
    return log.with_scans(changed)


@fault()
def objects_burst(
    log: Recording, count: Number = 5000, seconds: Duration = 3.0, *, rng: np.random.Generator
) -> Recording:
    """NUMBER more objects of the classes of the log appear for S from the middle of the drive on."""
    begin_ns, end_ns = log.from_half(seconds)
    labels, frame = log.labels or ["object"], log.body_frames()
    radius_m = _BURST_RADIUS_M * np.sqrt(rng.random(count))
    angle_rad = rng.uniform(-np.pi, np.pi, count)
    around = np.column_stack([radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad), np.zeros(count)])
    standing = apply(log.poses_at([begin_ns])[0], around)
    of_class = tuple(labels[i] for i in rng.integers(len(labels), size=count))
    changed = []
    for scan, T_odom_body in zip(log.scans, log.poses_at([scan.stamp_ns for scan in log.scans]), strict=True):
        if begin_ns <= scan.stamp_ns < end_ns:
            name = scan.detections.frame_id
            positions = apply(invert(T_odom_body @ frame(name)), standing)
            scan = scan.join(ObjectDetections(scan.stamp_ns, name, positions, of_class, np.ones(count)))
        changed.append(scan)
    return log.with_scans(changed)


@fault()
def objects_few(log: Recording, count: Number = 2) -> Recording:
    """Only the NUMBER objects that are seen most often remain."""
    seen = Counter(name for scan in log.scans_with_ids for name in scan.ids if name)
    kept = {name for name, _ in sorted(seen.items(), key=lambda item: (-item[1], item[0]))[:count]}
    return log.with_scans(
        scan if scan.truth is None else scan.select(np.array([name in kept for name in scan.ids], dtype=np.bool_))
        for scan in log.scans
    )


@fault()
def objects_moving(
    log: Recording, share: Share = 0.5, speed_m_s: _Speed = 2.0, *, rng: np.random.Generator
) -> Recording:
    """A share of the objects moves by M/S.

    Each time an object comes into view it moves straight on in a direction drawn at random.
    """
    scans = sorted(log.scans_with_ids, key=lambda scan: scan.stamp_ns)
    objects = sorted({name for scan in scans for name in scan.ids if name})
    drawn = rng.random(len(objects))
    moving = {name for name, number in zip(objects, drawn, strict=True) if number < share}
    frame = log.body_frames()
    passes: dict[str, tuple[int, int, FloatArray]] = {}  # when it came, when it was seen last, which way it goes
    changed = {}
    for scan, T_odom_body in zip(scans, log.poses_at([scan.stamp_ns for scan in scans]), strict=True):
        stamp_ns, positions = scan.stamp_ns, scan.detections.positions.copy()
        R_sensor_odom = (T_odom_body @ frame(scan.detections.frame_id))[:3, :3].T
        for row, name in enumerate(scan.ids):
            if name not in moving:
                continue
            came_ns, seen_ns, direction = passes.get(name, (0, -_IN_VIEW_AGAIN_NS, np.zeros(3)))
            if stamp_ns - seen_ns >= _IN_VIEW_AGAIN_NS:
                angle_rad = rng.uniform(-np.pi, np.pi)
                came_ns, direction = stamp_ns, np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
            passes[name] = (came_ns, stamp_ns, direction)
            positions[row] += R_sensor_odom @ direction * speed_m_s * (stamp_ns - came_ns) * 1e-9
        changed[scan] = scan.with_fields(positions=positions)
    return log.with_scans(changed.get(scan, scan) for scan in log.scans)


@fault("0.05", "20")
def lengths_scaled(log: Recording, factor: _LengthFactor = 0.05) -> Recording:
    """All lengths of the log and of its truth are multiplied."""
    units = np.repeat([1.0, factor], 3)
    powers = {"positions": factor, "sizes": factor, "covariances": factor**2, "covariance": np.outer(units, units)}
    powers |= dict.fromkeys(("T_odom_body", "T_parent_child", "T_world_body"), _lengths_of(factor))

    def scaled(message: Message[Any]) -> Message[Any]:
        fields = {name: getattr(message.record, name, None) for name in powers}
        return message.with_fields(**{k: powers[k] * value for k, value in fields.items() if value is not None})

    return Recording(
        tuple(map(scaled, log.odometry)),
        tuple(replace(scan, message=scaled(scan.message)) for scan in log.scans),
        tuple(map(scaled, log.transforms)),
        tuple(map(scaled, log.true_poses)),
        tuple(map(scaled, log.true_objects)),
        keeps_others=log.keeps_others,
    )


@fault()
def reversed(log: Recording) -> Recording:
    """The drive is played backwards, in reverse gear; topics that cannot be reversed are left out."""
    first_ns, last_ns = log.span_ns

    def mirrored(message: Message[Any]) -> Message[Any]:
        stamp_ns = max(first_ns + last_ns - message.record.stamp_ns, 0)
        delay_ns = message.log_time_ns - message.record.stamp_ns
        return replace(message.with_fields(stamp_ns=stamp_ns), log_time_ns=max(stamp_ns + delay_ns, 0))

    moving = _moving_frames(log)
    scans = (Scan(mirrored(scan.message), scan.truth and mirrored(scan.truth)) for scan in log.scans)
    return Recording(
        by_log_time(map(mirrored, log.odometry)),
        tuple(sorted(scans, key=lambda scan: scan.message.log_time_ns)),
        by_log_time(mirrored(each) if _frames(each.record) in moving else each for each in log.transforms),
        by_log_time(map(mirrored, log.true_poses)),
        log.true_objects,
        keeps_others=False,
    )


def _lengths_of(factor: float) -> FloatArray:
    """Factors of the entries (4, 4) of a transform."""
    factors = np.ones((4, 4))
    factors[:3, 3] = factor
    return factors


def _frames(transform: Transform) -> tuple[str, str]:
    return transform.parent_frame_id, transform.child_frame_id


def _moving_frames(log: Recording) -> set[tuple[str, str]]:
    """Frames (parent, child) whose transform changes."""
    first: dict[tuple[str, str], FloatArray] = {}
    return {
        _frames(message.record)
        for message in log.transforms
        if not np.allclose(
            first.setdefault(_frames(message.record), message.record.T_parent_child),
            message.record.T_parent_child,
            rtol=0.0,
            atol=1e-9,
        )
    }
