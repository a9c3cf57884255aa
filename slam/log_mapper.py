"""The messages of a log, from a file or as they come: through the estimator into the output."""

import time
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from logs.messages import (
    DetectionAssociations,
    FrameTree,
    GeodeticFix,
    LocalizationRecord,
    LogMessage,
    LoopClosureRecord,
    Record,
    SlamPose,
    StatusRecord,
    Transform,
)
from logs.reader import LogItem
from slam.common.georeference import Georeference
from slam.display.map_topics import FRAMES, LANDMARKS, LOG, MAP_FRAME, Message
from slam.final_map import FinalMap
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.stamp_clocks import StampClocks
from slam.live_slam import LiveSlam
from slam.localization.state import State
from slam.object_map.map_io import make_markers

LOCATION = "/slam/location"

_TOPICS: Mapping[type[Record], str] = {
    SlamPose: "/slam/pose",
    DetectionAssociations: "/slam/associations",
    StatusRecord: "/slam/status",
    LocalizationRecord: "/slam/localization",
    LoopClosureRecord: "/slam/closures",
}


class LogMapper:
    """Maps messages one by one, and writes what each makes known.

    ``fixes``: those of a satellite receiver.
    """

    def __init__(self, slam: LiveSlam, inputs: InputRecords, clocks: StampClocks, log: "OutputLog") -> None:
        self.slam = slam
        self.log = log
        self.clocks = clocks
        self.fixes: list[GeodeticFix] = []
        self._seconds = array("d")
        self._inputs = inputs

    def process(self, item: LogItem, log_time_ns: int) -> None:
        """Map the next message; what it makes known is written at a log time."""
        started = time.perf_counter()
        self._map(self.clocks.follow(item), log_time_ns)
        self._seconds.append(time.perf_counter() - started)

    def finish(self, log_time_ns: int, counters: Mapping[str, int]) -> FinalMap:
        """Map what still waits, and optimise everything at once; ``counters``: of what was read.

        Raises:
            InputDataError: there was nothing to map.
        """
        self._map(self.clocks.finish(), log_time_ns)
        self._inputs.check()
        self.log.write_updates(self.slam.catch_up(), log_time_ns)
        self.slam.counters.update(Counter(counters) + self._inputs.counters)
        return self.slam.finish()

    def latency_s(self) -> dict[str, float]:
        """How long messages took on this machine: the median, the 99th percentile and the longest, in seconds."""
        median, most, longest = np.percentile(self._seconds, [50.0, 99.0, 100.0]).round(4).tolist()
        return {"p50": median, "p99": most, "max": longest}

    def _map(self, records: Iterable[Record], log_time_ns: int) -> None:
        for record in self._inputs.prepare(records):
            if isinstance(record, GeodeticFix):
                self.fixes.append(record)
            self.log.write_updates(self.slam.process(record), log_time_ns)
            if (snapshot := self.slam.snapshot()) is not None:
                self.log.write_messages(snapshot, log_time_ns)


class OutputLog:
    """Writes the updates of the estimator at the log times of the input.

    ``writers`` are called with topic, record and log time of each; ``georeference``: where on earth the map is, if that
    is known; ``tracked`` counts the poses in the map.
    """

    def __init__(
        self, writers: Sequence[Callable[[str, Record, int], None]], georeference: Georeference | None = None
    ) -> None:
        self._writers = writers
        self._frames: dict[str, Transform] = {}  # by the child
        self._georeference = georeference
        self.tracked = 0

    def write_updates(self, updates: Iterable[Record], log_time_ns: int) -> None:
        """Write the updates by one record of the input."""
        for update in updates:
            self.write_messages(self._messages(update), log_time_ns)

    def write_messages(self, messages: Iterable[Message], log_time_ns: int) -> None:
        """Write records, each to its topic."""
        for topic, message in messages:
            for write in self._writers:
                write(topic, message, log_time_ns)

    def write_final(self, final: FinalMap, log_time_ns: int) -> None:
        """Write the results of the drive."""
        self.write_messages(
            [
                ("/slam/trajectory_stamped", final.trajectory),
                ("/slam/map", final.object_map),
                (LANDMARKS, make_markers(final.object_map)),
                ("/slam/graph", final.graph),
            ],
            log_time_ns,
        )
        self.write_updates([final.status], log_time_ns)
        self.write_messages(final.snapshot, log_time_ns)

    def _messages(self, update: Record) -> Iterator[Message]:
        """An update, and messages for viewers about it: texts, the place on earth, and all frames that are known, so
        that they need no other.
        """
        if type(update) in _TOPICS:
            yield _TOPICS[type(update)], update
        if isinstance(update, SlamPose):
            self.tracked += 1
            if self._georeference is not None:
                place = self._georeference.to_geodetic(update.T_map_body[None, :3, 3])[0]
                yield LOCATION, GeodeticFix(update.stamp_ns, MAP_FRAME, *place.tolist())
        elif isinstance(update, Transform):
            if update.child_frame_id != update.parent_frame_id:  # as of an odometry in the frame of the map
                self._frames[update.child_frame_id] = update
            if all(each.parent_frame_id != update.child_frame_id for each in self._frames.values()):  # the body
                frames = tuple(
                    each if each.stamp_ns == update.stamp_ns else replace(each, stamp_ns=update.stamp_ns)
                    for each in self._frames.values()
                )
                yield FRAMES, FrameTree(update.stamp_ns, frames)
        elif isinstance(update, StatusRecord):
            if update.state == State.LOST:
                self._frames = {
                    child: each for child, each in self._frames.items() if each.parent_frame_id != MAP_FRAME
                }
            yield LOG, LogMessage(update.stamp_ns, update.level, f"{update.state.lower()}: {update.message}")
        elif isinstance(update, LoopClosureRecord) and update.inserted:
            text = f"loop closed: keyframe {update.query_keyframe_id} with {update.reference_keyframe_id}"
            yield LOG, LogMessage(update.stamp_ns, "info", text)
