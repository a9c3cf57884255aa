"""Faults of where objects are seen: noise, covariances that are too small, wrong extrinsics."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from logs.messages import ObjectDetections, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert, make_transform
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
    detection_fault,
    fault,
)
from slam.simulation.faults.stream import (
    Entry,
    Stream,
    alter_detections,
    body_frames_of,
    move_detections,
    odometry_at,
    replace_scans,
    scans_with_ids,
    span_from_half,
    true_poses_at,
)

# In the axes of an optical frame (x right, y down, z forward), what is given in those of a body.
_R_OPTICAL_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_Claimed = Annotated[float, Range("m", min=1e-9, max=1e3)]


@detection_fault()
def unreported_noise(seen: ObjectDetections, sigma_m: Sigma = 1.0, *, rng: np.random.Generator) -> ObjectDetections:
    """Positions have M of noise on each axis that no covariance contains."""
    return replace(seen, positions=seen.positions + sigma_m * rng.standard_normal(seen.positions.shape))


@detection_fault()
def claimed_sigma(seen: ObjectDetections, sigma_m: _Claimed = 1e-3) -> ObjectDetections:
    """All covariances claim M on each axis."""
    return replace(seen, covariances=np.tile(sigma_m**2 * np.eye(3), (len(seen.labels), 1, 1)))


@detection_fault()
def one_point(seen: ObjectDetections, distance_m: Metres = 5.0) -> ObjectDetections:
    """All objects are seen M ahead of the sensor."""
    return replace(seen, positions=np.tile([distance_m, 0.0, 0.0], (len(seen.labels), 1)))


@detection_fault()
def sensor_upside_down(seen: ObjectDetections) -> ObjectDetections:
    """The sensor hangs upside down, turned about its x axis, without a transform."""
    return _turned(seen, np.diag([1.0, -1.0, -1.0]))


@detection_fault(cases=("10", "90"))
def sensor_yaw(seen: ObjectDetections, angle_deg: Degrees = 10.0) -> ObjectDetections:
    """The sensor is turned by DEG about its z axis, without a transform."""
    return _turned(seen, Rotation.from_euler("z", -angle_deg, degrees=True).as_matrix())


@detection_fault()
def ranges_scaled(seen: ObjectDetections, factor: Factor = 1.1) -> ObjectDetections:
    """All ranges are multiplied by a factor."""
    return replace(seen, positions=factor * seen.positions)


@detection_fault()
def sensor_optical(seen: ObjectDetections) -> ObjectDetections:
    """Positions are in optical axes (x right, y down, z forward), but messages name other axes."""
    return _turned(seen, _R_OPTICAL_BODY)


@fault(DETECTIONS, reads=(*ODOMETRY, *TRANSFORMS))
def height_offset(stream: Stream, height_m: Metres = 2.0) -> list[Entry]:
    """All objects are seen M too high, in the axes of the body."""
    frame, up = body_frames_of(stream), np.array([0.0, 0.0, height_m])
    return alter_detections(
        stream, lambda seen: replace(seen, positions=seen.positions + up @ frame(seen.frame_id)[:3, :3])
    )


@fault(DETECTIONS, reads=(*ODOMETRY, *TRANSFORMS))
def odometry_frame(stream: Stream) -> list[Entry]:
    """Positions are in the frame of the odometry; messages name that of the sensor."""
    frame = body_frames_of(stream)
    stamps_ns = np.array([e.stamp_ns for e in stream if isinstance(e.content, ObjectDetections)], dtype=np.int64)
    T_odom_body = iter(odometry_at(stream, stamps_ns) if len(stamps_ns) else ())
    return alter_detections(stream, lambda seen: move_detections(seen, next(T_odom_body) @ frame(seen.frame_id)))


@fault(DETECTIONS, reads=ODOMETRY)
def sensor_mirrored(stream: Stream, seconds: Duration = 20.0) -> list[Entry]:
    """Left and right of the sensor are exchanged for S from half time on."""
    begin_ns, end_ns = span_from_half(stream, seconds)

    def mirror(seen: ObjectDetections) -> ObjectDetections:
        left = -1.0 if begin_ns <= seen.stamp_ns < end_ns else 1.0
        return replace(seen, positions=seen.positions * [1.0, left, 1.0])

    return alter_detections(stream, mirror)


@fault(DETECTIONS, reads=(*ODOMETRY, *SCANS, *TRUTH, *TRANSFORMS), cases=("0.5", "3"))
def detection_noise(stream: Stream, factor: Factor = 3.0) -> list[Entry]:
    """Errors of positions against the truth are multiplied; covariances stay as they are."""
    objects, scans, frame = _true_positions(stream), scans_with_ids(stream), body_frames_of(stream)
    T_world_body = true_poses_at(stream, np.array([scan.stamp_ns for scan in scans], dtype=np.int64))
    changed = []
    for scan, T in zip(scans, T_world_body, strict=True):
        ids, seen = scan.object_ids or (), scan.detections.positions
        known = np.array([i in objects for i in ids], dtype=np.bool_)
        world = np.array([objects.get(i, np.zeros(3)) for i in ids]).reshape(-1, 3)
        true = apply(invert(T @ frame(scan.detections.frame_id)), world)
        changed.append(scan.with_fields(positions=np.where(known[:, None], true + factor * (seen - true), seen)))
    return replace_scans(stream, changed)


def _true_positions(stream: Stream) -> dict[str, FloatArray]:
    found: dict[str, FloatArray] = {}
    for entry in stream:
        if isinstance(entry.content, ObjectMapRecord):
            found |= dict(zip(entry.content.ids, entry.content.positions, strict=True))
    if not found:
        raise SimulationError("the log holds no true objects (/ground_truth/objects), which this fault needs")
    return found


def _turned(seen: ObjectDetections, R_wrong_sensor: FloatArray) -> ObjectDetections:
    return move_detections(seen, make_transform(R_wrong_sensor, np.zeros(3)))
