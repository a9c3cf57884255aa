"""Records -> protobuf messages: Foxglove's schemas where one exists, else ``dslam.*``. The mirror of ``decoders``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry as FoxgloveOdometry
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from logs import messages as m
from logs.scene import encode_lines, encode_markers, encode_points
from logs.schemas import dslam_pb2 as pb
from logs.validation import FloatArray, covariance_to_parent, quaternion_xyzw

_UNKNOWN_COVARIANCE = (0.0,) * 36


def encode(record: m.Record) -> Message:
    """The protobuf message of ``record``.

    Raises:
        TypeError: no record of ``logs.messages``.
    """
    encoder = _ENCODERS.get(type(record))
    if encoder is None:
        raise TypeError(f"{type(record).__name__} is no record of logs.messages")
    return encoder(record)


def encode_path(trajectory: m.TrajectoryRecord) -> Message:
    """``trajectory`` as foxglove.PosesInFrame, the line that viewers draw; it has no place for the poses' stamps."""
    return PosesInFrame(
        timestamp=_timestamp(trajectory.stamp_ns),
        frame_id=trajectory.frame_id,
        poses=[_pose(T) for T in trajectory.T_map_body],
    )


def _timestamp(stamp_ns: int) -> Timestamp:
    seconds, nanos = divmod(int(stamp_ns), 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)


def _pose(T: FloatArray) -> Pose:
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = T[:3, 3].tolist()
    q = pose.orientation
    q.x, q.y, q.z, q.w = quaternion_xyzw(T)
    return pose


def _transforms(T: FloatArray | None) -> list[float]:
    return [] if T is None else _flat(T[..., :3, :])


def _flat(array: Any) -> list[Any]:
    return [] if array is None else np.asarray(array).ravel().tolist()


def _odometry(r: m.Odometry) -> Message:
    covariance = r.covariance
    return FoxgloveOdometry(
        timestamp=_timestamp(r.stamp_ns),
        frame_id=r.frame_id,
        body_frame_id=r.child_frame_id,
        pose=_pose(r.T_odom_body),
        pose_covariance=(
            _UNKNOWN_COVARIANCE if covariance is None else _flat(covariance_to_parent(covariance, r.T_odom_body))
        ),
    )


def _ground_truth(r: m.GroundTruthPose) -> Message:
    return PoseInFrame(timestamp=_timestamp(r.stamp_ns), frame_id=r.frame_id, pose=_pose(r.T_world_body))


def _slam_pose(r: m.SlamPose) -> Message:
    return PoseInFrame(timestamp=_timestamp(r.stamp_ns), frame_id="map", pose=_pose(r.T_map_body))


def _transform(r: m.Transform) -> FrameTransform:
    message = FrameTransform(
        timestamp=_timestamp(r.stamp_ns), parent_frame_id=r.parent_frame_id, child_frame_id=r.child_frame_id
    )
    t, q = message.translation, message.rotation
    t.x, t.y, t.z = r.T_parent_child[:3, 3].tolist()
    q.x, q.y, q.z, q.w = quaternion_xyzw(r.T_parent_child)
    return message


def _location_fix(r: m.GeodeticFix) -> Message:
    return LocationFix(
        timestamp=_timestamp(r.stamp_ns),
        frame_id=r.frame_id,
        latitude=r.latitude_deg,
        longitude=r.longitude_deg,
        altitude=r.altitude_m,
        position_covariance=[0.0] * 9 if r.covariance is None else _flat(r.covariance),
        position_covariance_type=LocationFix.UNKNOWN if r.covariance is None else LocationFix.KNOWN,
    )


def _frame_tree(r: m.FrameTree) -> Message:
    return FrameTransforms(transforms=[_transform(each) for each in r.transforms])


def _log_message(r: m.LogMessage) -> Message:
    level = Log.Level.Value(r.level.upper())
    return Log(timestamp=_timestamp(r.stamp_ns), level=level, message=r.text, name="dslam")


def _detections(r: m.ObjectDetections) -> Message:
    return pb.ObjectDetections(
        stamp_ns=int(r.stamp_ns),
        frame_id=r.frame_id,
        positions=_flat(r.positions),
        labels=r.labels,
        scores=_flat(r.scores),
        covariances=_flat(r.covariances),
        sizes=_flat(r.sizes),
        track_ids=r.track_ids or (),
    )


def _detection_truth(r: m.DetectionTruth) -> Message:
    return pb.DetectionTruth(stamp_ns=int(r.stamp_ns), object_ids=r.object_ids)


def _associations(r: m.DetectionAssociations) -> Message:
    return pb.DetectionAssociations(
        stamp_ns=int(r.stamp_ns), landmark_ids=r.landmark_ids, created=_flat(r.created.astype(np.bool_))
    )


def _object_map(r: m.ObjectMapRecord) -> Message:
    return pb.ObjectMap(
        stamp_ns=int(r.stamp_ns),
        frame_id=r.frame_id,
        vocabulary=r.vocabulary,
        ids=r.ids,
        positions=_flat(r.positions),
        covariances=_flat(r.covariances),
        class_probabilities=_flat(r.class_probabilities),
        states=r.states,
        reasons=r.reasons,
        observation_counts=_flat(r.observation_counts),
        first_seen_ns=_flat(r.first_seen_ns),
        last_seen_ns=_flat(r.last_seen_ns),
        merged_into=r.merged_into,
    )


def _trajectory(r: m.TrajectoryRecord) -> Message:
    return pb.Trajectory(
        stamp_ns=int(r.stamp_ns),
        frame_id=r.frame_id,
        stamps_ns=_flat(r.stamps_ns),
        map_body=_transforms(r.T_map_body),
    )


def _factor_graph(r: m.FactorGraphRecord) -> Message:
    return pb.FactorGraph(
        stamp_ns=int(r.stamp_ns),
        keyframe_ids=_flat(r.keyframe_ids),
        keyframe_stamps_ns=_flat(r.keyframe_stamps_ns),
        map_body=_transforms(r.T_map_body),
        edge_keyframe_ids=_flat(r.edge_keyframe_ids),
        edge_from_to=_transforms(r.edge_transforms),
        edge_covariances=_flat(r.edge_covariances),
        edge_kinds=r.edge_kinds,
        observation_keyframe_ids=_flat(r.observation_keyframe_ids),
        observation_landmark_ids=r.observation_landmark_ids,
        observation_positions=_flat(r.observation_positions),
        observation_covariances=_flat(r.observation_covariances),
        pose_covariances=_flat(r.pose_covariances),
        observation_redundancies=_flat(r.observation_redundancies),
    )


def _loop_closure(r: m.LoopClosureRecord) -> Message:
    return pb.LoopClosure(
        stamp_ns=int(r.stamp_ns),
        query_keyframe_id=int(r.query_keyframe_id),
        reference_keyframe_id=int(r.reference_keyframe_id),
        accepted=bool(r.accepted),
        stage=r.stage,
        reason=r.reason,
        retrieval_distance=float(r.retrieval_distance),
        inlier_count=int(r.inlier_count),
        inlier_fraction=float(r.inlier_fraction),
        score=float(r.score),
        reference_query=_transforms(r.T_reference_query),
        covariance=_flat(r.covariance),
        reference_stamp_ns=int(r.reference_stamp_ns),
        inserted=bool(r.inserted),
        rank=int(r.rank),
        log_likelihood_ratio=r.log_likelihood_ratio,
        odometry_penalty=r.odometry_penalty,
        posterior_log_odds=r.posterior_log_odds,
        best_rival_log_likelihood_ratio=r.best_rival_log_likelihood_ratio,
        seed_query_keyframe_id=r.seed_query_keyframe_id,
        represented_by_keyframe_id=r.represented_by_keyframe_id,
    )


def _relocalization(r: m.RelocalizationRecord) -> Message:
    return pb.Relocalization(
        stamp_ns=int(r.stamp_ns),
        success=bool(r.success),
        reason=r.reason,
        map_body=_transforms(r.T_map_body),
        covariance=_flat(r.covariance),
        inlier_count=int(r.inlier_count),
        score=float(r.score),
    )


def _status(r: m.StatusRecord) -> Message:
    counters = {name: int(count) for name, count in r.counters.items()}
    return pb.Status(stamp_ns=int(r.stamp_ns), state=r.state, level=r.level, message=r.message, counters=counters)


_ENCODERS: dict[type, Callable[[Any], Message]] = {
    m.Odometry: _odometry,
    m.GroundTruthPose: _ground_truth,
    m.SlamPose: _slam_pose,
    m.Transform: _transform,
    m.GeodeticFix: _location_fix,
    m.ObjectDetections: _detections,
    m.DetectionTruth: _detection_truth,
    m.DetectionAssociations: _associations,
    m.ObjectMapRecord: _object_map,
    m.TrajectoryRecord: _trajectory,
    m.FactorGraphRecord: _factor_graph,
    m.LoopClosureRecord: _loop_closure,
    m.RelocalizationRecord: _relocalization,
    m.StatusRecord: _status,
    m.SceneMarkers: encode_markers,
    m.SceneLines: encode_lines,
    m.ScenePoints: encode_points,
    m.FrameTree: _frame_tree,
    m.LogMessage: _log_message,
}
