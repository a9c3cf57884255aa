"""What a log holds and what is wrong with it, from one pass over all of it."""

from array import array
from collections import Counter, defaultdict
from collections.abc import Mapping

import numpy as np

from logs import messages as m
from logs.closures import find_final_decisions
from logs.container.limits import ReadingLimits
from logs.errors import TopicSelectionError
from logs.reader import LogReader
from logs.records import frames_of, frozen
from logs.selection import Selection, select_all, select_topics
from logs.storage.regular_file import AnyPath
from logs.topics import RawMessage, RecordKind, TopicInfo

MAX_CLASSES = 20_000
"""More are too many to count each; the rarest are counted as one."""
OTHER_CLASSES = "(other classes)"


@frozen
class TopicSummary:
    """One topic. Its times are the stamps of its records where it has any, but for frames, which share a topic, and
    topics that do not decode, those at which it was logged. ``rate_hz`` is None below two messages; ``length_m`` of the
    path of an odometry, else None.

    ``frame_edges``: pairs of parent and child that its transforms, or its odometry, connect; names without the leading
    slash of ROS 1.
    """

    topic: str
    schema_name: str
    encoding: str
    kinds: tuple[RecordKind, ...]
    message_count: int
    first_ns: int
    last_ns: int
    rate_hz: float | None
    gap_count: int
    longest_gap_s: float
    duplicate_stamps: int
    out_of_order_stamps: int
    frames: tuple[str, ...]
    frame_edges: tuple[tuple[str, str], ...]
    length_m: float | None


@frozen
class LogSummary:
    """A log at a glance. ``selection`` is what a replay would use; empty where it cannot, and ``obstacle`` says why.

    ``class_counts`` counts detections, most frequent first. ``closure_candidates`` are the final decisions by query
    stamp. ``first_stamp_ns`` is the earliest of odometry and poses, or else ``start_ns``. ``counters`` are those of the
    reader, ``status`` is the last one in the log.
    """

    path: str
    size_bytes: int
    start_ns: int
    end_ns: int
    topics: tuple[TopicSummary, ...]
    class_counts: Mapping[str, int]
    selection: Selection
    obstacle: str
    closure_candidates: tuple[m.LoopClosureRecord, ...]
    first_stamp_ns: int
    metadata: Mapping[str, Mapping[str, str]]
    counters: Mapping[str, int]
    status: m.StatusRecord | None

    @property
    def duration_s(self) -> float:
        """Seconds from the first message to the last."""
        return (self.end_ns - self.start_ns) * 1e-9

    def time_s(self, stamp_ns: int) -> float:
        """Seconds since the first stamp."""
        return (stamp_ns - self.first_stamp_ns) * 1e-9


def summarize(
    path: AnyPath, overrides: Mapping[str, str] | None = None, limits: ReadingLimits | None = None
) -> LogSummary:
    """Read the whole log at ``path``; ``overrides`` (kind -> topic) as for :func:`logs.selection.select_topics`.

    Raises:
        UnreadableLogError: the file cannot be read or is no log.
    """
    with LogReader(path, limits) as reader:
        topics = reader.topics()
        try:
            selection, obstacle = select_topics(topics, overrides), ""
        except TopicSelectionError as error:
            selection, obstacle = Selection(), str(error)
        gathering = _Gathering()
        everything = Selection({**select_all(topics).kinds, **selection.kinds}, selection.mappings)
        # A graph is large, and nothing of it is shown.
        shown = everything.without(RecordKind.FACTOR_GRAPH)
        for item in reader.items(shown, copy=[info.topic for info in topics]):
            gathering.add(item.raw, item.records)
        start_ns = min(gathering.log_times_ns, default=0)
        return LogSummary(
            path=str(path),
            size_bytes=reader.size_bytes,
            start_ns=start_ns,
            end_ns=max(gathering.log_times_ns, default=0),
            topics=tuple(gathering.topics[info.topic, info.schema_name].summary(info) for info in topics),
            class_counts=dict(sorted(gathering.class_counts.items(), key=lambda pair: (-pair[1], pair[0]))),
            selection=selection,
            obstacle=obstacle,
            closure_candidates=find_final_decisions(gathering.closures),
            first_stamp_ns=min(gathering.pose_stamps_ns, default=start_ns),
            metadata=reader.metadata(),
            counters=reader.counters,
            status=gathering.status,
        )


class _TopicGathering:
    """The times, the frames and the length of one topic: eight bytes a message."""

    def __init__(self) -> None:
        self.times_ns: array[int] = array("q")
        self._frames: set[str] = set()
        self._edges: set[tuple[str, str]] = set()
        self._length_m: float | None = None
        self._xyz = np.zeros(3)

    def add(self, record: m.Record) -> None:
        """Note the frames that a record names and connects, and how far an odometry has moved."""
        names = [name.lstrip("/") for name in frames_of(record).values()]
        if len(self._frames) < 100:
            self._frames |= {*names} - {""}
            self._edges |= {(names[0], names[1])} if len(names) == 2 and all(names) else set()
        if isinstance(record, m.Odometry):
            xyz = record.T_odom_body[:3, 3]
            self._length_m = 0.0 if self._length_m is None else self._length_m + float(np.linalg.norm(xyz - self._xyz))
            self._xyz = xyz

    def summary(self, info: TopicInfo) -> TopicSummary:
        times_ns = np.array(self.times_ns, dtype=np.int64)
        out_of_order = int((times_ns[1:] < np.maximum.accumulate(times_ns)[:-1]).sum())
        times_ns.sort()
        first_ns, last_ns = (int(times_ns[0]), int(times_ns[-1])) if len(times_ns) else (0, 0)
        steps_ns = np.diff(times_ns)
        periods_ns = steps_ns[steps_ns > 0]
        return TopicSummary(
            topic=info.topic,
            schema_name=info.schema_name,
            encoding=info.encoding,
            kinds=info.kinds,
            message_count=len(times_ns),
            first_ns=first_ns,
            last_ns=last_ns,
            rate_hz=len(steps_ns) / ((last_ns - first_ns) * 1e-9) if last_ns > first_ns else None,
            # A pause is a gap when it is longer than five median periods.
            gap_count=int((periods_ns > 5.0 * np.median(periods_ns)).sum()) if len(periods_ns) else 0,
            longest_gap_s=float(periods_ns.max(initial=0) * 1e-9),
            duplicate_stamps=len(steps_ns) - len(periods_ns),
            out_of_order_stamps=out_of_order,
            frames=tuple(sorted(self._frames)),
            frame_edges=tuple(sorted(self._edges)),
            length_m=self._length_m,
        )


class _Gathering:
    """What accumulates in the pass."""

    def __init__(self) -> None:
        self.log_times_ns: array[int] = array("q")
        self.pose_stamps_ns: array[int] = array("q")
        self.class_counts: Counter[str] = Counter()
        self.closures: list[m.LoopClosureRecord] = []
        self.status: m.StatusRecord | None = None
        self.topics: dict[tuple[str, str], _TopicGathering] = defaultdict(_TopicGathering)

    def add(self, raw: RawMessage, records: tuple[m.Record, ...]) -> None:
        self.log_times_ns.append(raw.log_time_ns)
        topic = self.topics[raw.topic, raw.channel.schema_name]
        is_stamped = bool(records) and not isinstance(records[0], m.Transform)
        topic.times_ns.append(records[0].stamp_ns if is_stamped else raw.log_time_ns)
        for record in records:
            topic.add(record)
            if isinstance(record, (m.Odometry, m.SlamPose)):
                self.pose_stamps_ns.append(record.stamp_ns)
            elif isinstance(record, m.ObjectDetections):
                self._count_classes(record.labels)
            elif isinstance(record, m.LoopClosureRecord) and len(self.closures) < 100_000:
                self.closures.append(record)
            elif isinstance(record, m.StatusRecord):
                self.status = record

    def _count_classes(self, labels: tuple[str, ...]) -> None:
        self.class_counts.update(labels)
        if len(self.class_counts) > MAX_CLASSES:  # each may be an identity of its own
            kept = self.class_counts.most_common(MAX_CLASSES // 2)
            gone = self.class_counts.total() - sum(count for _, count in kept)
            self.class_counts = Counter(dict(kept)) + Counter({OTHER_CLASSES: gone})
