"""Which topic of a log plays which part."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

from logs.decoders.field_mapping import FieldMapping
from logs.errors import TopicSelectionError
from logs.topics import RecordKind, TopicInfo

GROUND_TRUTH_TOPIC = "/ground_truth"
DETECTION_TRUTH_TOPIC = "/ground_truth/detections"
OBJECT_TRUTH_TOPIC = "/ground_truth/objects"
OUTPUT_PREFIX = "/slam/"

NEEDED_FOR_MAPPING = (RecordKind.ODOMETRY, RecordKind.DETECTIONS)

_DEFAULT_TOPICS = {
    RecordKind.GROUND_TRUTH: GROUND_TRUTH_TOPIC,
    RecordKind.DETECTION_TRUTH: DETECTION_TRUTH_TOPIC,
    RecordKind.OBJECT_TRUTH: OBJECT_TRUTH_TOPIC,
}

_IN_IMAGES = ("vision_msgs/msg/Detection2DArray", "apriltag_msgs/msg/AprilTagDetectionArray")
"""Detections that a camera's calibration and depth are needed for."""

_CHOSEN = (RecordKind.ODOMETRY, RecordKind.DETECTIONS, RecordKind.GNSS)
_WEAKER = {
    "foxglove.PoseInFrame": 1,
    "geometry_msgs/msg/PoseStamped": 1,
    "geometry_msgs/msg/PoseWithCovarianceStamped": 1,
    "foxglove.SceneUpdate": 1,
    **dict.fromkeys(_IN_IMAGES, 2),
    "visualization_msgs/msg/MarkerArray": 3,
}
"""Rank of schemas that are taken where none of a smaller rank is there; that of others is 0: a topic that calls itself
odometry is one, a bare pose may come from anywhere; likewise a message made for detections, and a picture that may show
anything."""
_WHEN_ASKED_FOR = ("sensor_msgs/msg/PointCloud2",)
"""Most of these are scans without classes."""

_MAPPING_HINT = "name its fields, for example --topic 'detections=/plants:plants[] position=position label=kind'"


@dataclass(frozen=True, slots=True)
class Selection:
    """The kinds of records to read from each topic; a topic may play several parts.

    ``mappings``: by topic, where the fields of detections are in messages of other schemas than those that are known.
    """

    kinds: Mapping[str, tuple[RecordKind, ...]] = field(default_factory=dict)
    mappings: Mapping[str, FieldMapping] = field(default_factory=dict)

    @staticmethod
    def of(topics: Mapping[str, str]) -> "Selection":
        """From topic -> kind, for example ``{"/slam/closures": "loop_closures"}``."""
        return Selection({topic: (RecordKind(kind),) for topic, kind in topics.items()})

    @property
    def topics(self) -> tuple[str, ...]:
        """The selected topics, sorted."""
        return tuple(sorted(self.kinds))

    def only(self, kind: RecordKind) -> "Selection":
        """The topics that play the part ``kind``, in that part alone."""
        return Selection(dict.fromkeys(self.topics_of(kind), (kind,)), self.mappings)

    def without(self, *gone: RecordKind) -> "Selection":
        """The same without these parts."""
        kept = {
            topic: rest
            for topic, kinds in self.kinds.items()
            if (rest := tuple(kind for kind in kinds if kind not in gone))
        }
        return Selection(kept, self.mappings)

    def topics_of(self, kind: str) -> tuple[str, ...]:
        """The topics that play the part ``kind``, sorted; () for none."""
        return tuple(topic for topic in self.topics if kind in self.kinds[topic])


def select_topics(
    topics: Iterable[TopicInfo],
    overrides: Mapping[str, str] | None = None,
    *,
    needed: Collection[str] = NEEDED_FOR_MAPPING,
) -> Selection:
    """Choose the input topics for mapping: odometry, detections, transforms, and the truths where they are.

    Odometry and detections are the one topic of the strongest schema that is there: odometry messages, else poses, and
    frames of ``/tf`` only when asked for; detection messages, else scenes. Empty topics and those under
    ``/ground_truth`` and ``/slam/`` are never chosen for either, unless asked for.

    Args:
        topics: what the log holds.
        overrides: kind -> topic, or several separated by commas, which replaces the choice for that kind. Detections in
            messages of an unknown schema: "/topic:" and their fields, see :mod:`logs.decoders.field_mapping`.
        needed: kinds without which the log is of no use.

    Raises:
        TopicSelectionError: a needed kind has no topic, or several that are equally good; or an override names a kind
            that does not exist, or a topic that is not there or does not decode to it.
    """
    there = sorted(topics, key=lambda info: info.topic)
    chosen = {}
    mappings: dict[str, FieldMapping] = {}
    for name, topic in (overrides or {}).items():
        if name not in [*RecordKind]:
            raise TopicSelectionError(f"--topic {name}=...: unknown part; the parts are {', '.join(RecordKind)}")
        kind = RecordKind(name)
        chosen[kind] = [_overridden(there, kind, each.strip(), mappings) for each in topic.split(",")]
        if len(chosen[kind]) > 1 and kind == RecordKind.ODOMETRY:
            raise TopicSelectionError(f"--topic {kind}={topic}: the odometry is a single topic; name one")
    for kind in _CHOSEN:
        if kind not in chosen:
            chosen[kind] = _strongest(there, kind, is_needed=kind in needed)
    in_images = {info.topic for info in there if info.schema_name in _IN_IMAGES}
    for kind in (RecordKind.CAMERA_INFO, RecordKind.DEPTH):
        chosen.setdefault(kind, _of_cameras(there, kind) if in_images & {*chosen[RecordKind.DETECTIONS]} else [])
    for kind, topic in _DEFAULT_TOPICS.items():
        chosen.setdefault(kind, [info.topic for info in there if info.topic == topic and kind in info.kinds])
    chosen.setdefault(RecordKind.TRANSFORMS, [info.topic for info in _inputs(there, RecordKind.TRANSFORMS)])
    for kind in map(RecordKind, needed):
        if not chosen.get(kind):
            raise _nothing_fits(there, kind)
    kinds: dict[str, tuple[RecordKind, ...]] = {}
    for kind in RecordKind:
        for topic in chosen.get(kind, []):
            kinds[topic] = (*kinds.get(topic, ()), kind)
    return Selection(kinds, mappings)


def select_all(topics: Iterable[TopicInfo]) -> Selection:
    """Every topic that decodes to anything, in the part that its name and schema suggest: to read any log as it is."""
    kinds: dict[str, tuple[RecordKind, ...]] = {}
    for info in topics:
        if info.kinds and info.kinds != (RecordKind.DEPTH,):  # most images are pictures
            kinds.setdefault(info.topic, (_likely_kind(info),))
    return Selection(kinds)


def _likely_kind(info: TopicInfo) -> RecordKind:
    likely: tuple[RecordKind, ...] = ()
    if info.topic.startswith(GROUND_TRUTH_TOPIC):
        likely = (RecordKind.GROUND_TRUTH, RecordKind.OBJECT_TRUTH)
    elif info.topic.startswith(OUTPUT_PREFIX):
        likely = (RecordKind.SLAM_POSE,)
    return next((kind for kind in likely if kind in info.kinds), info.kinds[0])


def _inputs(there: list[TopicInfo], kind: RecordKind) -> list[TopicInfo]:
    """The topics that can play the part ``kind`` and are neither truth nor the output of a replay."""
    others = (GROUND_TRUTH_TOPIC, OUTPUT_PREFIX)
    return [info for info in there if kind in info.kinds and not info.topic.startswith(others)]


def _strongest(there: list[TopicInfo], kind: RecordKind, *, is_needed: bool) -> list[str]:
    """The one topic of the strongest schema that any has; none, or an error if one is needed, where several have it."""
    ranks = {
        info.topic: _WEAKER.get(info.schema_name, 0)
        for info in _inputs(there, kind)
        # Frames on /tf may not be the odometry.
        if info.message_count and RecordKind.TRANSFORMS not in info.kinds
        if info.schema_name not in _WHEN_ASKED_FOR
    }
    fitting = [topic for topic, rank in ranks.items() if rank == min(ranks.values())]
    if len(fitting) > 1 and is_needed:
        every = f", or use all: --topic {kind}={','.join(fitting)}" if kind == RecordKind.DETECTIONS else ""
        raise TopicSelectionError(
            f"{len(fitting)} topics could be the {kind}: {', '.join(fitting)}; choose one with "
            f"--topic {kind}={fitting[0]}{every}. {_listing(there)}"
        )
    return fitting if len(fitting) == 1 else []


def _of_cameras(there: list[TopicInfo], kind: RecordKind) -> list[str]:
    """All of them: which belongs to a detection, its frame tells. Of images, those with depth, aligned if there are."""
    topics = sorted({info.topic for info in there if kind in info.kinds and info.message_count})
    if kind == RecordKind.DEPTH:
        topics = [topic for topic in topics if "depth" in topic.lower()]
        topics = [topic for topic in topics if "aligned" in topic.lower()] or topics
    return topics


def _overridden(there: list[TopicInfo], kind: RecordKind, text: str, mappings: dict[str, FieldMapping]) -> str:
    topic, _, fields = text.partition(":")
    of_topic = [info for info in there if info.topic == topic]
    if not of_topic:
        raise TopicSelectionError(f"--topic {kind}={topic}: the log has no such topic. {_listing(there)}")
    if fields and kind == RecordKind.DETECTIONS:
        mappings[topic] = FieldMapping.parse(fields)
    elif not any(kind in info.kinds for info in of_topic):
        raise TopicSelectionError(
            f"--topic {kind}={topic}: {of_topic[0].schema_name or 'a topic without a schema'} does not decode to "
            f"{kind}{f'; {_MAPPING_HINT}' if kind == RecordKind.DETECTIONS else ''}. {_listing(there)}"
        )
    return topic


def _nothing_fits(there: list[TopicInfo], kind: RecordKind) -> TopicSelectionError:
    fitting = [info.topic for info in _inputs(there, kind)]
    if not fitting and any(info.topic.startswith(OUTPUT_PREFIX) for info in there):
        return TopicSelectionError(f"no topic gives {kind}: 'dslam replay' wrote this log; give the log of the drive")
    remedy = "record a topic with a schema that does (docs/log.md lists them)"
    if kind == RecordKind.DETECTIONS:
        remedy += f", or {_MAPPING_HINT}"
    if fitting:
        remedy = f"if one of {', '.join(fitting)} is meant, say --topic {kind}={fitting[0]}"
    return TopicSelectionError(f"no topic gives {kind}; {remedy}. {_listing(there)}")


def _listing(there: list[TopicInfo]) -> str:
    lines = [f"{info.topic} ({info.schema_name or 'no schema'}, {info.message_count})" for info in there]
    return f"Topics of the log: {', '.join(lines)}" if lines else "The log has no topics."
