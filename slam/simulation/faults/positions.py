"""Faults of where objects are seen: noise, covariances that are too small, wrong extrinsics."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from logs.messages import ObjectDetections, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert
from slam.simulation.faults.fault import (
    DETECTIONS,
    ODOMETRY,
    SCANS,
    TRANSFORMS,
    TRUTH,
    Degrees,
    Duration,
    Factor,
    Metres,
    Range,
    Sigma,
    fault,
)
from slam.simulation.faults.stream import (
    HALF,
    Entry,
    Stream,
    alter_detections,
    body_frames_of,
    odometry_at,
    replace_scans,
    scans_of,
    seconds_ns,
    stamp_at,
    true_poses_at,
)

# In the axes of an optical frame (x right, y down, z forward), what is given in those of a body.
_R_OPTICAL_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_Claimed = Annotated[float, Range("m", min=1e-9, max=1e3)]


@fault(DETECTIONS)
def unreported_noise(stream: Stream, sigma_m: Sigma = 1.0, *, rng: np.random.Generator) -> list[Entry]:
    """Positions have M of noise on each axis that no covariance contains."""

    def alter(detections: ObjectDetections) -> ObjectDetections:
        noise = sigma_m * rng.standard_normal(detections.positions.shape)
        return replace(detections, positions=detections.positions + noise)

    return alter_detections(stream, alter)


@fault(DETECTIONS)
def claimed_sigma(stream: Stream, sigma_m: _Claimed = 1e-3) -> list[Entry]:
    """All covariances claim M on each axis."""

    def alter(detections: ObjectDetections) -> ObjectDetections:
        return replace(detections, covariances=np.tile(sigma_m**2 * np.eye(3), (len(detections.labels), 1, 1)))

    return alter_detections(stream, alter)


@fault(DETECTIONS)
def one_point(stream: Stream, distance_m: Metres = 5.0) -> list[Entry]:
    """All objects are seen M ahead of the sensor."""

    def alter(detections: ObjectDetections) -> ObjectDetections:
        return replace(detections, positions=np.tile([distance_m, 0.0, 0.0], (len(detections.labels), 1)))

    return alter_detections(stream, alter)


@fault(DETECTIONS, reads=(*ODOMETRY, *TRANSFORMS))
def height_offset(stream: Stream, height_m: Metres = 2.0) -> list[Entry]:
    """All objects are seen M too high, in the axes of the body."""
    frame = body_frames_of(stream)

    def alter(detections: ObjectDetections) -> ObjectDetections:
        up = frame(detections.frame_id)[:3, :3].T @ np.array([0.0, 0.0, height_m])
        return replace(detections, positions=detections.positions + up)

    return alter_detections(stream, alter)


@fault(DETECTIONS, reads=(*ODOMETRY, *TRANSFORMS))
def odometry_frame(stream: Stream) -> list[Entry]:
    """Positions are in the frame of the odometry; messages name that of the sensor."""
    frame = body_frames_of(stream)
    stamps_ns = np.array(
        [e.content.stamp_ns for e in stream if isinstance(e.content, ObjectDetections)], dtype=np.int64
    )
    T_odom_body = iter(odometry_at(stream, stamps_ns) if len(stamps_ns) else ())

    def alter(detections: ObjectDetections) -> ObjectDetections:
        T_odom_sensor = next(T_odom_body) @ frame(detections.frame_id)
        R, covariances = T_odom_sensor[:3, :3], detections.covariances
        return replace(
            detections,
            positions=apply(T_odom_sensor, detections.positions),
            covariances=None if covariances is None else R @ covariances @ R.T,
        )

    return alter_detections(stream, alter)


@fault(DETECTIONS)
def sensor_upside_down(stream: Stream) -> list[Entry]:
    """The sensor hangs upside down, turned about its x axis, without a transform."""
    return _turned(stream, np.diag([1.0, -1.0, -1.0]))


@fault(DETECTIONS, cases=("10", "90"))
def sensor_yaw(stream: Stream, angle_deg: Degrees = 10.0) -> list[Entry]:
    """The sensor is turned by DEG about its z axis, without a transform."""
    return _turned(stream, Rotation.from_euler("z", -angle_deg, degrees=True).as_matrix())


@fault(DETECTIONS)
def ranges_scaled(stream: Stream, factor: Factor = 1.1) -> list[Entry]:
    """All objects are seen farther away by a factor."""
    return alter_detections(stream, lambda detections: replace(detections, positions=factor * detections.positions))


@fault(DETECTIONS, reads=ODOMETRY)
def sensor_mirrored(stream: Stream, seconds: Duration = 20.0) -> list[Entry]:
    """Left and right of the sensor are exchanged for S from half time on."""
    begin_ns = stamp_at(stream, HALF)
    end_ns = begin_ns + seconds_ns(seconds)

    def alter(detections: ObjectDetections) -> ObjectDetections:
        if not begin_ns <= detections.stamp_ns < end_ns:
            return detections
        return replace(detections, positions=detections.positions * [1.0, -1.0, 1.0])

    return alter_detections(stream, alter)


@fault(DETECTIONS)
def sensor_optical(stream: Stream) -> list[Entry]:
    """Positions are in optical axes (x right, y down, z forward); messages name other ones."""
    return _turned(stream, _R_OPTICAL_BODY)


@fault(DETECTIONS, reads=(*ODOMETRY, *SCANS, *TRUTH, *TRANSFORMS), cases=("0.5", "3"))
def detection_noise(stream: Stream, factor: Factor = 3.0) -> list[Entry]:
    """Errors of positions against the truth are multiplied; covariances stay as they are."""
    objects = _true_positions(stream)
    scans = [s for s in scans_of(stream) if s.object_ids is not None]
    if not scans:
        raise SimulationError("the log holds no true ids of its detections (/ground_truth/detections), needed here")
    T_world_body = true_poses_at(stream, np.array([s.detections.stamp_ns for s in scans], dtype=np.int64))
    frame = body_frames_of(stream)
    changed = []
    for scan, T in zip(scans, T_world_body, strict=True):
        ids, seen = scan.object_ids or (), scan.detections.positions
        known = np.array([i in objects for i in ids], dtype=np.bool_)
        world = np.array([objects.get(i, np.zeros(3)) for i in ids]).reshape(-1, 3)
        true = apply(invert(T @ frame(scan.detections.frame_id)), world)
        positions = np.where(known[:, None], true + factor * (seen - true), seen)
        changed.append(scan._replace(detections=replace(scan.detections, positions=positions)))
    return replace_scans(stream, changed)


def _true_positions(stream: Stream) -> dict[str, FloatArray]:
    found: dict[str, FloatArray] = {}
    for entry in stream:
        if isinstance(entry.content, ObjectMapRecord):
            found |= dict(zip(entry.content.ids, entry.content.positions, strict=True))
    if not found:
        raise SimulationError("the log holds no true objects (/ground_truth/objects), which this fault needs")
    return found


def _turned(stream: Stream, R_wrong_sensor: FloatArray) -> list[Entry]:
    def alter(detections: ObjectDetections) -> ObjectDetections:
        covariances = detections.covariances
        return replace(
            detections,
            positions=detections.positions @ R_wrong_sensor.T,
            covariances=None if covariances is None else R_wrong_sensor @ covariances @ R_wrong_sensor.T,
        )

    return alter_detections(stream, alter)
