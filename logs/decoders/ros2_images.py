"""What ROS 2 cameras see: boxes and tags in the image, how the camera projects, and depth.

* vision_msgs/msg/Detection2DArray: boxes; where a result has a pose of its own, the object is there.
* apriltag_msgs/msg/AprilTagDetectionArray: tags, of the class "family:number", which is also their frame on /tf.
* sensor_msgs/msg/CameraInfo, and sensor_msgs/msg/Image with depth: 16UC1 in millimetres or 32FC1 in metres.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from logs.decoders.parts import DetectionGroups
from logs.decoders.ros2_detections import hypothesis_of, place_of, position_covariance
from logs.messages import CameraModel, DepthImage, ImageDetections, Record
from logs.topics import RawMessage
from logs.validation import Refusal

_DEPTH = {"16UC1": (np.uint16, 1e-3), "mono16": (np.uint16, 1e-3), "32FC1": (np.float32, 1.0)}


def detections_2d(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """Records of a Detection2DArray: boxes, and objects whose results have a pose."""
    groups = DetectionGroups()
    own = place_of(message.header, raw.log_time_ns)
    boxes: list[tuple[float, float, float, float]] = []
    labels: list[str] = []
    scores: list[float] = []
    for detection in message.detections:
        best = max(detection.results, key=lambda result: hypothesis_of(result)[1], default=None)
        label, score = ("", 1.0) if best is None else hypothesis_of(best)
        p = None if best is None else best.pose.pose.position
        if best is not None and p is not None and any((p.x, p.y, p.z)):
            place = place_of(detection.header, raw.log_time_ns, own)
            groups.of(*place).add((p.x, p.y, p.z), label, score, covariance=position_covariance(best.pose.covariance))
            continue
        center = getattr(detection.bbox.center, "position", detection.bbox.center)
        boxes.append((center.x, center.y, detection.bbox.size_x, detection.bbox.size_y))
        labels.append(label or "unknown")
        scores.append(score)
    placed = groups.records(counters)
    if placed and not boxes:
        return placed
    stamp, frame = own
    pixels = _finite(np.array(boxes, dtype=np.float64).reshape(-1, 4))
    clipped = np.clip(_finite(np.array(scores)), 0.0, 1.0)
    return (*placed, ImageDetections(stamp, frame, pixels, tuple(labels), clipped))


def tags(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """The record of an AprilTagDetectionArray."""
    stamp, frame = place_of(message.header, raw.log_time_ns)
    found = message.detections
    corners = _finite(
        np.array([[(p.x, p.y) for p in tag.corners] for tag in found], dtype=np.float64).reshape(-1, 4, 2)
    )
    low, high = corners.min(axis=1), corners.max(axis=1)
    boxes = np.concatenate([0.5 * (low + high), high - low], axis=1)
    labels = tuple(f"{tag.family}:{tag.id}" for tag in found)
    return (ImageDetections(stamp, frame, boxes, labels, np.ones(len(labels)), corners),)


def camera_info(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """The record of a CameraInfo; none where the camera was not calibrated."""
    stamp, frame = place_of(message.header, raw.log_time_ns)
    K = np.array(message.k, dtype=np.float64).reshape(3, 3)
    if not K.any():
        return ()
    if not (np.isfinite(K).all() and K[0, 0] > 0.0 and K[1, 1] > 0.0):
        raise Refusal("camera matrix is none", f"k={K.ravel().tolist()}")
    return (CameraModel(stamp, frame, K, _finite(np.array(message.d, dtype=np.float64)), message.distortion_model),)


def depth_image(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """The record of an image with depth."""
    if message.encoding not in _DEPTH:
        raise Refusal("image without depth", f"encoding {message.encoding!r}, not {' or '.join(_DEPTH)}")
    kind, scale = _DEPTH[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    if len(message.data) < height * step or step < width * dtype.itemsize:
        raise Refusal("lengths disagree", f"{len(message.data)} bytes for an image of {width} x {height}")
    rows = np.frombuffer(bytes(message.data), np.uint8)[: height * step].reshape(height, step)
    depths = np.ascontiguousarray(rows[:, : width * dtype.itemsize]).view(dtype).astype(np.float32) * np.float32(scale)
    stamp, frame = place_of(message.header, raw.log_time_ns)
    return (DepthImage(stamp, frame, np.where(depths > 0.0, depths, np.nan)),)


def _finite(values: Any) -> Any:
    if not np.isfinite(values).all():
        raise Refusal("number is not finite", "in an image")
    return values
