"""The nouns of a log file as this project sees it: raw messages, topics, and the kinds of records they decode to."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from logs.records import frozen


class RecordKind(StrEnum):
    """The part that a topic plays. One schema may serve several: a pose is odometry or ground truth by its topic."""

    ODOMETRY = "odometry"
    DETECTIONS = "detections"
    GROUND_TRUTH = "ground_truth"
    TRANSFORMS = "transforms"
    CAMERA_INFO = "camera_info"
    DEPTH = "depth"
    GNSS = "gnss"
    DETECTION_TRUTH = "detection_truth"
    OBJECT_TRUTH = "object_truth"
    OBJECT_MAP = "object_map"
    ASSOCIATIONS = "associations"
    SLAM_POSE = "slam_pose"
    TRAJECTORY = "trajectory"
    FACTOR_GRAPH = "factor_graph"
    LOOP_CLOSURES = "loop_closures"
    STATUS = "status"
    LOCALIZATION = "localization"


class Schema(NamedTuple):
    """Name, encoding ("protobuf", "ros2msg", ...) and definition of a message type."""

    name: str
    encoding: str
    data: bytes


@frozen
class Channel:
    """One stream of messages: its topic, the encoding of its messages ("protobuf", "cdr", ...), its schema if any."""

    topic: str
    message_encoding: str
    schema: Schema | None
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def schema_name(self) -> str:
        """Name of the schema, "" where the channel has none."""
        return self.schema.name if self.schema else ""


@frozen
class RawMessage:
    """One message as it stands in the file, undecoded; times are integer nanoseconds."""

    channel: Channel
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes

    @property
    def topic(self) -> str:
        """Topic of its channel."""
        return self.channel.topic


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """What a log holds on one topic; ``kinds`` are those that its messages can be decoded to, () for none.

    Its messages lie between the first and the last log time, which are None without messages.
    """

    topic: str
    schema_name: str
    encoding: str
    message_count: int
    kinds: tuple[RecordKind, ...]
    first_log_time_ns: int | None
    last_log_time_ns: int | None
