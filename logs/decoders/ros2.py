"""Messages of ROS 2 and ROS 1, read by the definitions that the log itself carries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from logs.decoders import ros2_clouds as clouds
from logs.decoders import ros2_detections as objects
from logs.decoders import ros2_images as images
from logs.decoders.cdr import parse
from logs.decoders.parts import Context, Records, fix_records, frame_records, pose_records
from logs.decoders.registry import ROS_DETECTIONS
from logs.decoders.ros2_detections import place_of
from logs.validation import Refusal


def decode(context: Context) -> Records:
    """Records of one message; see :data:`logs.decoders.registry.Decoder`.

    Raises:
        Refusal: bytes that are no such message, a definition without the usual fields, or values no record may have.
    """
    schema = context.raw.channel.schema
    if schema is None:
        raise Refusal("no definition of the message in the log")
    return _DECODERS[schema.name](parse(schema, context.raw.data), context)


def _odometry(message: Any, context: Context) -> Records:
    return pose_records(context, place_of(message.header, context), message.pose.pose, message.child_frame_id)


def _pose_with_covariance(message: Any, context: Context) -> Records:
    return pose_records(context, place_of(message.header, context), message.pose.pose)


def _tf(message: Any, context: Context) -> Records:
    frames = (
        (place_of(t.header, context), t.child_frame_id, t.transform.translation, t.transform.rotation)
        for t in message.transforms
    )
    return frame_records(context, frames)


def _fix(message: Any, context: Context) -> Records:
    if message.status.status < 0:  # the receiver has no fix
        return ()
    return fix_records(context, place_of(message.header, context), message)


_DECODERS: dict[str, Callable[[Any, Context], Records]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": lambda m, context: pose_records(context, place_of(m.header, context), m.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "tf2_msgs/msg/TFMessage": _tf,
    "tf/msg/tfMessage": _tf,
    "sensor_msgs/msg/NavSatFix": _fix,
    "vision_msgs/msg/Detection3DArray": objects.detections_3d,
    **{name: objects.autoware_objects for name in ROS_DETECTIONS if name.startswith("autoware")},
    "visualization_msgs/msg/MarkerArray": objects.markers,
    "geometry_msgs/msg/PoseArray": objects.poses,
    "vision_msgs/msg/Detection2DArray": images.detections_2d,
    "apriltag_msgs/msg/AprilTagDetectionArray": images.tags,
    "sensor_msgs/msg/PointCloud2": clouds.labelled_scan,
    "sensor_msgs/msg/CameraInfo": images.camera_info,
    "sensor_msgs/msg/Image": images.depth_image,
}
