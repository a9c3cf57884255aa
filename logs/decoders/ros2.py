"""Messages of ROS 2, read by the definitions that the log itself carries."""

from typing import Any

import numpy as np

from logs.clouds.labelled_cloud import LabelledCloud, labelled_cloud
from logs.decoders import ros2_detections as objects
from logs.decoders import ros2_images as images
from logs.decoders.parts import (
    DETECTIONS,
    FRAMES,
    POSE,
    Context,
    MessageDecoder,
    Records,
    fix_records,
    frame_records,
    place_of,
    pose_decoder,
)
from logs.errors import DatasetError
from logs.messages import LabelledScan
from logs.topics import RecordKind
from logs.validation import Refusal

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Of the numbers of points."""


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
    points = images.image_rows(message, int(message.row_step), int(message.width) * point_step).view(kind).ravel()
    try:
        return (LabelledScan(*place, labelled_cloud({name: points[name] for name in fields}, "cloud").finite()),)
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
    "vision_msgs/msg/Detection3DArray": MessageDecoder(DETECTIONS, objects.detections_3d),
    **{
        f"{package}/msg/{name}": MessageDecoder(DETECTIONS, objects.autoware_objects)
        for package in AUTOWARE
        for name in ("TrackedObjects", "DetectedObjects")
    },
    "visualization_msgs/msg/MarkerArray": MessageDecoder(DETECTIONS, objects.markers),
    "vision_msgs/msg/Detection2DArray": MessageDecoder(DETECTIONS, images.detections_2d),
    "apriltag_msgs/msg/AprilTagDetectionArray": MessageDecoder(DETECTIONS, images.tags),
    "sensor_msgs/msg/PointCloud2": MessageDecoder(DETECTIONS, labelled_scan),
    "sensor_msgs/msg/CameraInfo": MessageDecoder((RecordKind.CAMERA_INFO,), images.camera_info),
    "sensor_msgs/msg/Image": MessageDecoder((RecordKind.DEPTH,), images.depth_image),
}
"""Schema -> what decodes its messages."""
