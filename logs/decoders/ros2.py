"""Messages of ROS 2, read by the definitions that the log itself carries."""

from __future__ import annotations

from typing import Any

from logs.decoders import ros2_clouds as clouds
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
from logs.messages import Transform
from logs.topics import RecordKind
from logs.validation import transform_of


def _tf(message: Any, context: Context) -> Records:
    transforms = tuple(
        Transform(*place_of(t, context), t.child_frame_id, transform_of(t.transform.translation, t.transform.rotation))
        for t in message.transforms
    )
    return frame_records(transforms, context.kind)


AUTOWARE = ("autoware_perception_msgs", "autoware_auto_perception_msgs")
DECODERS = {
    "nav_msgs/msg/Odometry": MessageDecoder(POSE, pose_decoder("pose.pose", "child_frame_id")),
    "geometry_msgs/msg/PoseStamped": MessageDecoder(POSE, pose_decoder("pose")),
    "geometry_msgs/msg/PoseWithCovarianceStamped": MessageDecoder(POSE, pose_decoder("pose.pose")),
    "tf2_msgs/msg/TFMessage": MessageDecoder(FRAMES, _tf),
    "tf/msg/tfMessage": MessageDecoder(FRAMES, _tf),
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
    "sensor_msgs/msg/PointCloud2": MessageDecoder(DETECTIONS, clouds.labelled_scan),
    "sensor_msgs/msg/CameraInfo": MessageDecoder((RecordKind.CAMERA_INFO,), images.camera_info),
    "sensor_msgs/msg/Image": MessageDecoder((RecordKind.DEPTH,), images.depth_image),
}
"""Schema -> what decodes its messages."""
