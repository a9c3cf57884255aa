"""What ROS 2 cameras see: boxes and tags in the image, how the camera projects, and depth.

* vision_msgs/msg/Detection2DArray: boxes.
* apriltag_msgs/msg/AprilTagDetectionArray: tags, of the class "family:number", which is also their frame on /tf.
* sensor_msgs/msg/CameraInfo, and sensor_msgs/msg/Image with depth: 16UC1 in millimetres or 32FC1 in metres.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.decoders.parts import UNKNOWN_LABEL, Context, Records, place_of
from logs.decoders.ros2_detections import best_result, hypothesis_of
from logs.messages import CameraModel, DepthImage, ImageDetections
from logs.validation import FloatArray, Refusal

_DEPTH = {"16UC1": (np.uint16, 1e-3), "mono16": (np.uint16, 1e-3), "32FC1": (np.float32, 1.0)}


def detections_2d(message: Any, context: Context) -> Records:
    """The record of a Detection2DArray."""
    boxes, labels, scores = [], list[str](), []
    for detection in message.detections:
        label, score = hypothesis_of(best_result(detection))
        center = getattr(detection.bbox.center, "position", detection.bbox.center)
        boxes.append((center.x, center.y, detection.bbox.size_x, detection.bbox.size_y))
        labels.append(label or UNKNOWN_LABEL)
        scores.append(score)
    pixels, clipped = _finite(boxes).reshape(-1, 4), np.clip(_finite(scores), 0.0, 1.0)
    return (ImageDetections(*place_of(message, context), pixels, tuple(labels), clipped),)


def tags(message: Any, context: Context) -> Records:
    """The record of an AprilTagDetectionArray."""
    found = message.detections
    corners = _finite([[(p.x, p.y) for p in tag.corners] for tag in found]).reshape(-1, 4, 2)
    low, high = corners.min(axis=1), corners.max(axis=1)
    boxes = np.concatenate([0.5 * (low + high), high - low], axis=1)
    labels = tuple(f"{tag.family}:{tag.id}" for tag in found)
    return (ImageDetections(*place_of(message, context), boxes, labels, np.ones(len(labels)), corners),)


def camera_info(message: Any, context: Context) -> Records:
    """The record of a CameraInfo; none where the camera was not calibrated."""
    k, d = (message.k, message.d) if hasattr(message, "k") else (message.K, message.D)  # as converted from ROS 1
    K = np.array(k, dtype=np.float64).reshape(3, 3)
    if not K.any():
        return ()
    if not (np.isfinite(K).all() and K[0, 0] > 0.0 and K[1, 1] > 0.0):
        raise Refusal("camera matrix is missing or invalid", f"k={K.ravel().tolist()}")
    return (CameraModel(*place_of(message, context), K, _finite(d), message.distortion_model),)


def depth_image(message: Any, context: Context) -> Records:
    """The record of an image with depth."""
    if message.encoding not in _DEPTH:
        raise Refusal("image without depth", f"encoding {message.encoding!r}, not {' or '.join(_DEPTH)}")
    kind, scale = _DEPTH[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    rows = image_rows(message, int(message.step), int(message.width) * dtype.itemsize)
    depths = rows.view(dtype).astype(np.float32) * np.float32(scale)
    return (DepthImage(*place_of(message, context), np.where(depths > 0.0, depths, np.nan)),)


def image_rows(message: Any, step: int, width: int) -> NDArray[np.uint8]:
    """The first ``width`` bytes of each of the rows of ``step`` bytes of an image or cloud: (height, width).

    Raises:
        Refusal: a row is shorter, or there are fewer rows than the message says.
    """
    height = int(message.height)
    if step < width or len(message.data) < height * step:
        raise Refusal("lengths disagree", f"{len(message.data)} bytes for {height} rows of {width} in {step} bytes")
    rows = np.frombuffer(bytes(message.data), np.uint8)[: height * step].reshape(height, step)
    return np.ascontiguousarray(rows[:, :width])


def _finite(values: Any) -> FloatArray:
    numbers = np.array(values, dtype=np.float64)
    if not np.isfinite(numbers).all():
        raise Refusal("number is not finite", "in an image")
    return numbers
