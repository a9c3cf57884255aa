"""Definitions of ROS 2 messages for recordings that hold none: databases written before ROS 2 Iron.

``rosbags-convert --src-typestore-ref logs.decoders.ros2_types:TYPES`` reads such a recording by them. The types of ROS
itself come from the library ``rosbags``. The layouts of perception messages, of packages that are not part of ROS
itself, are written down here; they are those of the releases for ROS 2 Humble.
"""

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from logs.decoders.ros2 import AUTOWARE

_HEADER = "std_msgs/Header header\n"

_PERCEPTION = {
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y",
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/Detection2D": (
        f"{_HEADER}vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox2D bbox\nstring id"
    ),
    "vision_msgs/msg/Detection3D": (
        f"{_HEADER}vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "vision_msgs/msg/Detection2DArray": f"{_HEADER}vision_msgs/Detection2D[] detections",
    "vision_msgs/msg/Detection3DArray": f"{_HEADER}vision_msgs/Detection3D[] detections",
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y",
    "apriltag_msgs/msg/AprilTagDetection": (
        "string family\nint32 id\nint32 hamming\nfloat32 goodness\nfloat32 decision_margin\n"
        "apriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography"
    ),
    "apriltag_msgs/msg/AprilTagDetectionArray": f"{_HEADER}apriltag_msgs/AprilTagDetection[] detections",
}

_AUTOWARE = {
    "ObjectClassification": (
        "uint8 UNKNOWN=0\nuint8 CAR=1\nuint8 TRUCK=2\nuint8 BUS=3\nuint8 TRAILER=4\nuint8 MOTORCYCLE=5\n"
        "uint8 BICYCLE=6\nuint8 PEDESTRIAN=7\nuint8 label\nfloat32 probability"
    ),
    "Shape": "uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions",
    "DetectedObjectKinematics": (
        "geometry_msgs/PoseWithCovariance pose_with_covariance\nbool has_position_covariance\n"
        "uint8 orientation_availability\ngeometry_msgs/TwistWithCovariance twist_with_covariance\nbool has_twist\n"
        "bool has_twist_covariance"
    ),
    "TrackedObjectKinematics": (
        "geometry_msgs/PoseWithCovariance pose_with_covariance\nuint8 orientation_availability\n"
        "geometry_msgs/TwistWithCovariance twist_with_covariance\n"
        "geometry_msgs/AccelWithCovariance acceleration_with_covariance\nbool is_stationary"
    ),
    "DetectedObject": (
        "float32 existence_probability\nObjectClassification[] classification\n"
        "DetectedObjectKinematics kinematics\nShape shape"
    ),
    "TrackedObject": (
        "unique_identifier_msgs/UUID object_id\nfloat32 existence_probability\nObjectClassification[] classification\n"
        "TrackedObjectKinematics kinematics\nShape shape"
    ),
    "DetectedObjects": f"{_HEADER}DetectedObject[] objects",
    "TrackedObjects": f"{_HEADER}TrackedObject[] objects",
}


TYPES = get_typestore(Stores.ROS2_HUMBLE)
"""The types of ROS 2 Humble, and those of perception messages."""

_OF_AUTOWARE = {f"{package}/msg/{name}": text for package in AUTOWARE for name, text in _AUTOWARE.items()}
for _name, _text in (_PERCEPTION | _OF_AUTOWARE).items():
    TYPES.register(get_types_from_msg(_text, _name))
