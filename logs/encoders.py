"""Records -> protobuf messages: Foxglove's schemas where one exists, else ``dslam.*``. The mirror of ``decoders``."""

from collections.abc import Callable
from functools import cache
from typing import Any

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message

from logs import messages as m
from logs.dslam_codec import CODECS
from logs.errors import InvalidRecordError
from logs.scene import encode_lines, encode_markers, encode_points, timestamp
from logs.topics import Schema
from logs.validation import FloatArray, quaternion_xyzw


def encode(record: m.Record) -> Message:
    """The protobuf message of ``record``.

    Raises:
        InvalidRecordError: no record of ``logs.messages``, or a string that is not valid Unicode.
    """
    encoder = _ENCODERS.get(type(record))
    if encoder is None:
        raise InvalidRecordError(f"{type(record).__name__} is no record; give Odometry, ObjectDetections, ...")
    try:
        return encoder(record)
    except UnicodeEncodeError as error:
        raise InvalidRecordError(f"{type(record).__name__}: {error.object!r:.40} is not valid Unicode") from error


@cache
def definition_of(message_type: Any) -> Schema:
    """The schema of a message, defined by a FileDescriptorSet, dependencies first, in the order of their import."""
    definition = FileDescriptorSet()
    seen = set()

    def add(file: Any) -> None:
        if file.name not in seen:
            seen.add(file.name)
            for dependency in file.dependencies:
                add(dependency)
            file.CopyToProto(definition.file.add())

    add(message_type.file)
    return Schema(message_type.full_name, "protobuf", definition.SerializeToString(deterministic=True))


def _place(position: Vector3, orientation: Quaternion, T: FloatArray) -> None:
    position.x, position.y, position.z = T[:3, 3].tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = quaternion_xyzw(T)


def _pose_in_frame(stamp_ns: int, frame_id: str, T: FloatArray) -> Message:
    message = PoseInFrame(timestamp=timestamp(stamp_ns), frame_id=frame_id)
    _place(message.pose.position, message.pose.orientation, T)
    return message


def _odometry(r: m.Odometry) -> Message:
    message = Odometry(
        timestamp=timestamp(r.stamp_ns),
        frame_id=r.frame_id,
        body_frame_id=r.child_frame_id,
        # Unknown.
        pose_covariance=(0.0,) * 36,
    )
    _place(message.pose.position, message.pose.orientation, r.T_odom_body)
    return message


def _transform(r: m.Transform) -> FrameTransform:
    message = FrameTransform(
        timestamp=timestamp(r.stamp_ns), parent_frame_id=r.parent_frame_id, child_frame_id=r.child_frame_id
    )
    _place(message.translation, message.rotation, r.T_parent_child)
    return message


def _location_fix(r: m.GeodeticFix) -> Message:
    return LocationFix(
        timestamp=timestamp(r.stamp_ns),
        frame_id=r.frame_id,
        latitude=r.latitude_deg,
        longitude=r.longitude_deg,
        altitude=r.altitude_m,
        position_covariance=[0.0] * 9 if r.covariance is None else r.covariance.ravel().tolist(),
        position_covariance_type=LocationFix.UNKNOWN if r.covariance is None else LocationFix.KNOWN,
    )


_ENCODERS: dict[type, Callable[[Any], Message]] = {
    **{record: codec.encode for record, codec in CODECS.items()},
    m.Odometry: _odometry,
    m.GroundTruthPose: lambda r: _pose_in_frame(r.stamp_ns, r.frame_id, r.T_world_body),
    m.SlamPose: lambda r: _pose_in_frame(r.stamp_ns, "map", r.T_map_body),
    m.Transform: _transform,
    m.GeodeticFix: _location_fix,
    m.SceneMarkers: encode_markers,
    m.SceneLines: encode_lines,
    m.ScenePoints: encode_points,
    m.FrameTree: lambda r: FrameTransforms(transforms=[_transform(each) for each in r.transforms]),
    m.LogMessage: lambda r: Log(timestamp=timestamp(r.stamp_ns), level=r.level.upper(), message=r.text, name="dslam"),
}
