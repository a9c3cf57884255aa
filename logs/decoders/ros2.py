"""Messages of ROS 2, read by the definitions that the log itself carries.

Objects in three dimensions. Each is at the stamp and in the frame of its own header; where that is empty, of the
array's.

* vision_msgs/msg/Detection3DArray: the class and the score are those of the result with the highest score, the position
  is the centre of the box, or, where the box was left empty, the pose of that result; the covariance is that of the
  result's pose.
* autoware (auto_)perception_msgs DetectedObjects, TrackedObjects: the class is the most probable one, by the name that
  the log's own definition gives its number.
* visualization_msgs/msg/MarkerArray: cubes, spheres, cylinders and meshes that are added, not deleted; a class is the
  marker's text, else its namespace.

What cameras see: boxes and tags in the image, how the camera projects, and depth.

* vision_msgs/msg/Detection2DArray: boxes.
* apriltag_msgs/msg/AprilTagDetectionArray: tags, of the class "family:number", which is also their frame on /tf.
* sensor_msgs/msg/CameraInfo, and sensor_msgs/msg/Image with depth: 16UC1 in millimetres or 32FC1 in metres.
"""

from collections import defaultdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.clouds.labelled_cloud import LabelledCloud, labelled_cloud
from logs.decoders.parts import (
    DETECTIONS,
    FRAMES,
    POSE,
    UNKNOWN_LABEL,
    Context,
    Detection,
    MessageDecoder,
    Place,
    Records,
    detection_records,
    fix_records,
    frame_records,
    place_of,
    pose_decoder,
    xyz,
)
from logs.errors import DatasetError
from logs.messages import CameraModel, DepthImage, ImageDetections, LabelledScan
from logs.topics import RecordKind
from logs.validation import FloatArray, Refusal

_DEPTH = {"16UC1": (np.uint16, 1e-3), "mono16": (np.uint16, 1e-3), "32FC1": (np.float32, 1.0)}
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Of the numbers of points."""


def detections_3d(message: Any, context: Context) -> Records:
    """Records of a Detection3DArray."""
    own = place_of(message, context)
    scans: dict[Place, list[Detection]] = defaultdict(list, {own: []})
    for detection in message.detections:
        best = best_result(detection)
        position = xyz(detection.bbox.center.position)
        if best is not None and not any(position) and not any(xyz(detection.bbox.size)):
            position = xyz(best.pose.pose.position)
        scans[place_of(detection, context, own)].append(
            Detection(
                position,
                *hypothesis_of(best),
                covariance=np.zeros((3, 3)) if best is None else position_covariance(best.pose.covariance),
            )
        )
    return detection_records(scans, context.counters)


def autoware_objects(message: Any, context: Context) -> Records:
    """Records of DetectedObjects or TrackedObjects."""
    found = []
    for seen in message.objects:
        best = max(seen.classification, key=lambda c: c.probability, default=None)
        placed = seen.kinematics.pose_with_covariance
        is_known = getattr(seen.kinematics, "has_position_covariance", True)
        found.append(
            Detection(
                xyz(placed.pose.position),
                "" if best is None else _class_name(best),
                seen.existence_probability,
                covariance=position_covariance(placed.covariance) if is_known else np.zeros((3, 3)),
            )
        )
    return detection_records({place_of(message, context): found}, context.counters)


def _class_name(best: Any) -> str:
    """The name of a number, in small letters, by the constants of an ObjectClassification."""
    names: dict[Any, str] = {number: name.lower() for name, number in vars(type(best)).items() if name.isupper()}
    return names.get(best.label, f"class {best.label}")


def markers(message: Any, context: Context) -> Records:
    """Records of a MarkerArray."""
    scans: dict[Place, list[Detection]] = defaultdict(list)
    for marker in message.markers:
        # Added: a cube, a sphere, a cylinder or a mesh.
        if marker.action == 0 and marker.type in (1, 2, 3, 10):
            found = Detection(xyz(marker.pose.position), marker.text or marker.ns)
            scans[place_of(marker, context)].append(found)
    return detection_records(scans, context.counters)


def best_result(detection: Any) -> Any:
    """The result with the highest score; None where there is none."""
    return max(detection.results, key=lambda result: hypothesis_of(result)[1], default=None)


def hypothesis_of(result: Any) -> tuple[str, float]:
    """Class and score of a result, "" and 1 of None; early vision_msgs have them, the class by its number, in it."""
    if result is None:
        return "", 1.0
    hypothesis = getattr(result, "hypothesis", result)
    label = getattr(hypothesis, "class_id", None)
    return (str(hypothesis.id) if label is None else label), hypothesis.score


def position_covariance(values: Any) -> FloatArray:
    """``(3, 3)`` m^2 of the 36 numbers of ROS.

    A coordinate whose row is zero while others are not was not estimated: it gets the largest variance of the others.
    """
    P = np.array(values, dtype=np.float64).reshape(6, 6)[:3, :3]
    empty = ~(P.any(axis=0) | P.any(axis=1))
    P[empty, empty] = np.diagonal(P).max()
    return P


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


def labelled_scan(message: Any, context: Context) -> Records:
    """The record of a sensor_msgs/msg/PointCloud2 whose points have a class, and perhaps an instance; those without
    finite coordinates are left out.
    """
    place = place_of(message, context)
    point_step = int(message.point_step)
    if message.height * message.width == 0:
        return (LabelledScan(*place, LabelledCloud(np.zeros((0, 3)), np.zeros(0, np.int64))),)
    if point_step < 1:
        raise Refusal("lengths disagree", f"points of {point_step} bytes")
    order = ">" if message.is_bigendian else "<"
    numbers = [field for field in message.fields if field.count == 1 and field.datatype in _TYPES]
    fields = {field.name: (order + _TYPES[field.datatype], field.offset) for field in numbers}
    try:
        formats, offsets = zip(*fields.values(), strict=True) if fields else ((), ())
        kind = np.dtype({"names": [*fields], "formats": formats, "offsets": offsets, "itemsize": point_step})
    except (ValueError, TypeError) as error:
        raise Refusal("fields of the points are invalid", str(error)) from error
    points = image_rows(message, int(message.row_step), int(message.width) * point_step).view(kind).ravel()
    try:
        return (LabelledScan(*place, labelled_cloud({name: points[name] for name in fields}).finite()),)
    except DatasetError as error:
        raise Refusal("cloud without labels", str(error)) from error


AUTOWARE = ("autoware_perception_msgs", "autoware_auto_perception_msgs")
DECODERS = {
    "nav_msgs/msg/Odometry": MessageDecoder(POSE, pose_decoder("pose.pose", "child_frame_id")),
    "geometry_msgs/msg/PoseStamped": MessageDecoder(POSE, pose_decoder("pose")),
    "geometry_msgs/msg/PoseWithCovarianceStamped": MessageDecoder(POSE, pose_decoder("pose.pose")),
    "tf2_msgs/msg/TFMessage": MessageDecoder(FRAMES, frame_records),
    "tf/msg/tfMessage": MessageDecoder(FRAMES, frame_records),
    "sensor_msgs/msg/NavSatFix": MessageDecoder((RecordKind.GNSS,), fix_records),
    "vision_msgs/msg/Detection3DArray": MessageDecoder(DETECTIONS, detections_3d),
    **{
        f"{package}/msg/{name}": MessageDecoder(DETECTIONS, autoware_objects)
        for package in AUTOWARE
        for name in ("TrackedObjects", "DetectedObjects")
    },
    "visualization_msgs/msg/MarkerArray": MessageDecoder(DETECTIONS, markers),
    "vision_msgs/msg/Detection2DArray": MessageDecoder(DETECTIONS, detections_2d),
    "apriltag_msgs/msg/AprilTagDetectionArray": MessageDecoder(DETECTIONS, tags),
    "sensor_msgs/msg/PointCloud2": MessageDecoder(DETECTIONS, labelled_scan),
    "sensor_msgs/msg/CameraInfo": MessageDecoder((RecordKind.CAMERA_INFO,), camera_info),
    "sensor_msgs/msg/Image": MessageDecoder((RecordKind.DEPTH,), depth_image),
}
"""Schema -> what decodes its messages."""
