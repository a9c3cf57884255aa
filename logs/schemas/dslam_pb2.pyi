from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class ObjectDetections(_message.Message):
    __slots__ = ("stamp_ns", "frame_id", "positions", "labels", "scores", "covariances")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    LABELS_FIELD_NUMBER: _ClassVar[int]
    SCORES_FIELD_NUMBER: _ClassVar[int]
    COVARIANCES_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    frame_id: str
    positions: _containers.RepeatedScalarFieldContainer[float]
    labels: _containers.RepeatedScalarFieldContainer[str]
    scores: _containers.RepeatedScalarFieldContainer[float]
    covariances: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, stamp_ns: _Optional[int] = ..., frame_id: _Optional[str] = ..., positions: _Optional[_Iterable[float]] = ..., labels: _Optional[_Iterable[str]] = ..., scores: _Optional[_Iterable[float]] = ..., covariances: _Optional[_Iterable[float]] = ...) -> None: ...

class DetectionTruth(_message.Message):
    __slots__ = ("stamp_ns", "object_ids")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    OBJECT_IDS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    object_ids: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, stamp_ns: _Optional[int] = ..., object_ids: _Optional[_Iterable[str]] = ...) -> None: ...

class DetectionAssociations(_message.Message):
    __slots__ = ("stamp_ns", "landmark_ids", "created")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    LANDMARK_IDS_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    landmark_ids: _containers.RepeatedScalarFieldContainer[str]
    created: _containers.RepeatedScalarFieldContainer[bool]
    def __init__(self, stamp_ns: _Optional[int] = ..., landmark_ids: _Optional[_Iterable[str]] = ..., created: _Optional[_Iterable[bool]] = ...) -> None: ...

class ObjectMap(_message.Message):
    __slots__ = ("stamp_ns", "frame_id", "vocabulary", "ids", "positions", "covariances", "class_probabilities", "states", "reasons", "observation_counts", "first_seen_ns", "last_seen_ns", "merged_into")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    VOCABULARY_FIELD_NUMBER: _ClassVar[int]
    IDS_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    COVARIANCES_FIELD_NUMBER: _ClassVar[int]
    CLASS_PROBABILITIES_FIELD_NUMBER: _ClassVar[int]
    STATES_FIELD_NUMBER: _ClassVar[int]
    REASONS_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_COUNTS_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEEN_NS_FIELD_NUMBER: _ClassVar[int]
    LAST_SEEN_NS_FIELD_NUMBER: _ClassVar[int]
    MERGED_INTO_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    frame_id: str
    vocabulary: _containers.RepeatedScalarFieldContainer[str]
    ids: _containers.RepeatedScalarFieldContainer[str]
    positions: _containers.RepeatedScalarFieldContainer[float]
    covariances: _containers.RepeatedScalarFieldContainer[float]
    class_probabilities: _containers.RepeatedScalarFieldContainer[float]
    states: _containers.RepeatedScalarFieldContainer[str]
    reasons: _containers.RepeatedScalarFieldContainer[str]
    observation_counts: _containers.RepeatedScalarFieldContainer[int]
    first_seen_ns: _containers.RepeatedScalarFieldContainer[int]
    last_seen_ns: _containers.RepeatedScalarFieldContainer[int]
    merged_into: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, stamp_ns: _Optional[int] = ..., frame_id: _Optional[str] = ..., vocabulary: _Optional[_Iterable[str]] = ..., ids: _Optional[_Iterable[str]] = ..., positions: _Optional[_Iterable[float]] = ..., covariances: _Optional[_Iterable[float]] = ..., class_probabilities: _Optional[_Iterable[float]] = ..., states: _Optional[_Iterable[str]] = ..., reasons: _Optional[_Iterable[str]] = ..., observation_counts: _Optional[_Iterable[int]] = ..., first_seen_ns: _Optional[_Iterable[int]] = ..., last_seen_ns: _Optional[_Iterable[int]] = ..., merged_into: _Optional[_Iterable[str]] = ...) -> None: ...

class Trajectory(_message.Message):
    __slots__ = ("stamp_ns", "frame_id", "stamps_ns", "map_body")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    STAMPS_NS_FIELD_NUMBER: _ClassVar[int]
    MAP_BODY_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    frame_id: str
    stamps_ns: _containers.RepeatedScalarFieldContainer[int]
    map_body: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, stamp_ns: _Optional[int] = ..., frame_id: _Optional[str] = ..., stamps_ns: _Optional[_Iterable[int]] = ..., map_body: _Optional[_Iterable[float]] = ...) -> None: ...

class FactorGraph(_message.Message):
    __slots__ = ("stamp_ns", "keyframe_ids", "keyframe_stamps_ns", "map_body", "edge_keyframe_ids", "edge_from_to", "edge_covariances", "edge_kinds", "observation_keyframe_ids", "observation_landmark_ids", "observation_positions", "observation_covariances", "pose_covariances", "observation_redundancies")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    KEYFRAME_IDS_FIELD_NUMBER: _ClassVar[int]
    KEYFRAME_STAMPS_NS_FIELD_NUMBER: _ClassVar[int]
    MAP_BODY_FIELD_NUMBER: _ClassVar[int]
    EDGE_KEYFRAME_IDS_FIELD_NUMBER: _ClassVar[int]
    EDGE_FROM_TO_FIELD_NUMBER: _ClassVar[int]
    EDGE_COVARIANCES_FIELD_NUMBER: _ClassVar[int]
    EDGE_KINDS_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_KEYFRAME_IDS_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_LANDMARK_IDS_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_POSITIONS_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_COVARIANCES_FIELD_NUMBER: _ClassVar[int]
    POSE_COVARIANCES_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_REDUNDANCIES_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    keyframe_ids: _containers.RepeatedScalarFieldContainer[int]
    keyframe_stamps_ns: _containers.RepeatedScalarFieldContainer[int]
    map_body: _containers.RepeatedScalarFieldContainer[float]
    edge_keyframe_ids: _containers.RepeatedScalarFieldContainer[int]
    edge_from_to: _containers.RepeatedScalarFieldContainer[float]
    edge_covariances: _containers.RepeatedScalarFieldContainer[float]
    edge_kinds: _containers.RepeatedScalarFieldContainer[str]
    observation_keyframe_ids: _containers.RepeatedScalarFieldContainer[int]
    observation_landmark_ids: _containers.RepeatedScalarFieldContainer[str]
    observation_positions: _containers.RepeatedScalarFieldContainer[float]
    observation_covariances: _containers.RepeatedScalarFieldContainer[float]
    pose_covariances: _containers.RepeatedScalarFieldContainer[float]
    observation_redundancies: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, stamp_ns: _Optional[int] = ..., keyframe_ids: _Optional[_Iterable[int]] = ..., keyframe_stamps_ns: _Optional[_Iterable[int]] = ..., map_body: _Optional[_Iterable[float]] = ..., edge_keyframe_ids: _Optional[_Iterable[int]] = ..., edge_from_to: _Optional[_Iterable[float]] = ..., edge_covariances: _Optional[_Iterable[float]] = ..., edge_kinds: _Optional[_Iterable[str]] = ..., observation_keyframe_ids: _Optional[_Iterable[int]] = ..., observation_landmark_ids: _Optional[_Iterable[str]] = ..., observation_positions: _Optional[_Iterable[float]] = ..., observation_covariances: _Optional[_Iterable[float]] = ..., pose_covariances: _Optional[_Iterable[float]] = ..., observation_redundancies: _Optional[_Iterable[float]] = ...) -> None: ...

class LoopClosure(_message.Message):
    __slots__ = ("stamp_ns", "query_keyframe_id", "reference_keyframe_id", "accepted", "stage", "reason", "inlier_count", "score", "reference_query", "covariance", "reference_stamp_ns", "inserted", "log_likelihood_ratio", "odometry_penalty", "posterior_log_odds", "seed_query_keyframe_id", "proposer")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    QUERY_KEYFRAME_ID_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_KEYFRAME_ID_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    INLIER_COUNT_FIELD_NUMBER: _ClassVar[int]
    SCORE_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_QUERY_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    INSERTED_FIELD_NUMBER: _ClassVar[int]
    LOG_LIKELIHOOD_RATIO_FIELD_NUMBER: _ClassVar[int]
    ODOMETRY_PENALTY_FIELD_NUMBER: _ClassVar[int]
    POSTERIOR_LOG_ODDS_FIELD_NUMBER: _ClassVar[int]
    SEED_QUERY_KEYFRAME_ID_FIELD_NUMBER: _ClassVar[int]
    PROPOSER_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    query_keyframe_id: int
    reference_keyframe_id: int
    accepted: bool
    stage: str
    reason: str
    inlier_count: int
    score: float
    reference_query: _containers.RepeatedScalarFieldContainer[float]
    covariance: _containers.RepeatedScalarFieldContainer[float]
    reference_stamp_ns: int
    inserted: bool
    log_likelihood_ratio: float
    odometry_penalty: float
    posterior_log_odds: float
    seed_query_keyframe_id: int
    proposer: str
    def __init__(self, stamp_ns: _Optional[int] = ..., query_keyframe_id: _Optional[int] = ..., reference_keyframe_id: _Optional[int] = ..., accepted: bool = ..., stage: _Optional[str] = ..., reason: _Optional[str] = ..., inlier_count: _Optional[int] = ..., score: _Optional[float] = ..., reference_query: _Optional[_Iterable[float]] = ..., covariance: _Optional[_Iterable[float]] = ..., reference_stamp_ns: _Optional[int] = ..., inserted: bool = ..., log_likelihood_ratio: _Optional[float] = ..., odometry_penalty: _Optional[float] = ..., posterior_log_odds: _Optional[float] = ..., seed_query_keyframe_id: _Optional[int] = ..., proposer: _Optional[str] = ...) -> None: ...

class Status(_message.Message):
    __slots__ = ("stamp_ns", "state", "level", "message", "counters")
    class CountersEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    state: str
    level: str
    message: str
    counters: _containers.ScalarMap[str, int]
    def __init__(self, stamp_ns: _Optional[int] = ..., state: _Optional[str] = ..., level: _Optional[str] = ..., message: _Optional[str] = ..., counters: _Optional[_Mapping[str, int]] = ...) -> None: ...

class Localization(_message.Message):
    __slots__ = ("stamp_ns", "state", "lost_probability", "sources", "innovation_ratios", "covariance")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    LOST_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    SOURCES_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_RATIOS_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    state: str
    lost_probability: float
    sources: _containers.RepeatedScalarFieldContainer[str]
    innovation_ratios: _containers.RepeatedScalarFieldContainer[float]
    covariance: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, stamp_ns: _Optional[int] = ..., state: _Optional[str] = ..., lost_probability: _Optional[float] = ..., sources: _Optional[_Iterable[str]] = ..., innovation_ratios: _Optional[_Iterable[float]] = ..., covariance: _Optional[_Iterable[float]] = ...) -> None: ...

class StreamMessage(_message.Message):
    __slots__ = ("topic", "schema", "log_time_ns", "data")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    SCHEMA_FIELD_NUMBER: _ClassVar[int]
    LOG_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    topic: str
    schema: str
    log_time_ns: int
    data: bytes
    def __init__(self, topic: _Optional[str] = ..., schema: _Optional[str] = ..., log_time_ns: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...
