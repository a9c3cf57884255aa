"""All that viewers are shown of a drive while it is mapped."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from logs.messages import (
    GroundTruthPose,
    LogMessage,
    LoopClosureRecord,
    Record,
    SlamPose,
    StatusRecord,
    Transform,
)
from slam.display.frames import Frames
from slam.display.map_topics import MapTopics, Message
from slam.display.snapshot import MapSnapshot
from slam.localization.state import State

FRAMES, LOG = "/tf", "/slam/log"


class DriveDisplay:
    """Turns what the estimator makes known into messages for viewers."""

    def __init__(self, sensor_range_m: float, ground_truth: Iterable[GroundTruthPose] = ()) -> None:
        """``ground_truth``: what the frame of the truth is tied to the map by."""
        self._map = MapTopics(sensor_range_m)
        self._frames = Frames(ground_truth)
        self._is_closed = False  # since the map was shown last

    def show(self, update: Record) -> Iterator[Message]:
        """Messages about one update of the estimate."""
        if isinstance(update, Transform):
            self._frames.add(update)
            if self._frames.is_leaf(update.child_frame_id):  # the body, with which all others are told
                yield FRAMES, self._frames.tree(update.stamp_ns)
        elif isinstance(update, SlamPose):
            self._frames.tie(update)
        elif isinstance(update, StatusRecord):
            if update.state == State.LOST:
                self._frames.detach_from_map()
            yield LOG, LogMessage(update.stamp_ns, update.level, f"{update.state.lower()}: {update.message}")
        elif isinstance(update, LoopClosureRecord) and update.inserted:
            self._is_closed = True
            text = f"loop closed: keyframe {update.query_keyframe_id} with {update.reference_keyframe_id}"
            yield LOG, LogMessage(update.stamp_ns, "info", text)

    def show_map(self, snapshot: MapSnapshot, *, is_final: bool = False) -> list[Message]:
        """Messages about the map; all of it if ``is_final``."""
        is_closed, self._is_closed = self._is_closed, False
        return self._map.update(snapshot, is_closed=is_closed, is_final=is_final)
