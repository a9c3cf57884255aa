"""Faults of where objects are seen: noise, covariances that are too small, wrong extrinsics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from logs.messages import ObjectDetections, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert
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

# In the axes of an optical frame (x right, y down, z forward), what is told in those of a body.
_R_OPTICAL_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def add_noise(stream: Stream, rng: np.random.Generator, sigma_m: float) -> list[Entry]:
    """Positions have more noise, on each axis, than their covariances say."""

    def alter(detections: ObjectDetections) -> ObjectDetections:
        noise = sigma_m * rng.standard_normal(detections.positions.shape)
        return replace(detections, positions=detections.positions + noise)

    return alter_detections(stream, alter)


def claim_sigma(stream: Stream, rng: np.random.Generator, sigma_m: float) -> list[Entry]:
    """All covariances say the same standard deviation on each axis."""

    def alter(detections: ObjectDetections) -> ObjectDetections:
        return replace(detections, covariances=np.tile(sigma_m**2 * np.eye(3), (len(detections.labels), 1, 1)))

    return alter_detections(stream, alter)


def see_at_one_point(stream: Stream, rng: np.random.Generator, distance_m: float) -> list[Entry]:
    """All objects are seen at one point ahead of the sensor."""

    def alter(detections: ObjectDetections) -> ObjectDetections:
        return replace(detections, positions=np.tile([distance_m, 0.0, 0.0], (len(detections.labels), 1)))

    return alter_detections(stream, alter)


def shift_heights(stream: Stream, rng: np.random.Generator, height_m: float) -> list[Entry]:
    """All objects are seen too high, in the axes of the body."""
    frame = body_frames_of(stream)

    def alter(detections: ObjectDetections) -> ObjectDetections:
        up = frame(detections.frame_id)[:3, :3].T @ np.array([0.0, 0.0, height_m])
        return replace(detections, positions=detections.positions + up)

    return alter_detections(stream, alter)


def place_in_odometry_frame(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """Positions are those in the frame of the odometry, as a tracker has them, and are told to be in the sensor's."""
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


def turn_upside_down(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """The sensor hangs upside down, turned about its x axis, and no transform tells."""
    return _turned(stream, np.diag([1.0, -1.0, -1.0]))


def turn_sensor(stream: Stream, rng: np.random.Generator, angle_deg: float) -> list[Entry]:
    """The sensor is turned about its z axis, and no transform tells."""
    return _turned(stream, Rotation.from_euler("z", -angle_deg, degrees=True).as_matrix())


def scale_ranges(stream: Stream, rng: np.random.Generator, factor: float) -> list[Entry]:
    """All objects are seen too far off, or too near, by a factor."""
    return alter_detections(stream, lambda detections: replace(detections, positions=factor * detections.positions))


def mirror(stream: Stream, rng: np.random.Generator, seconds: float) -> list[Entry]:
    """From the half on, left and right of the sensor are exchanged for a while."""
    begin_ns = stamp_at(stream, HALF)
    end_ns = begin_ns + seconds_ns(seconds)

    def alter(detections: ObjectDetections) -> ObjectDetections:
        if not begin_ns <= detections.stamp_ns < end_ns:
            return detections
        return replace(detections, positions=detections.positions * [1.0, -1.0, 1.0])

    return alter_detections(stream, alter)


def see_in_optical_axes(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """Positions are those of an optical frame, and are told to be in the frame as it was."""
    return _turned(stream, _R_OPTICAL_BODY)


def scale_detection_noise(stream: Stream, rng: np.random.Generator, factor: float) -> list[Entry]:
    """The error of each position against the truth is multiplied by a factor; covariances stay as they are."""
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
    return replace_scans(stream, [scan._replace(truth_row=None) for scan in changed])


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
