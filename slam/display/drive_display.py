"""Messages for viewers beside the map: frames and texts."""

from __future__ import annotations

from collections.abc import Iterator

from logs.messages import LogMessage, LoopClosureRecord, Record, StatusRecord, Transform
from slam.display.frames import Frames
from slam.display.map_topics import Message
from slam.localization.state import State

FRAMES, LOG = "/tf", "/slam/log"


class DriveDisplay:
    """Turns updates of the estimate into messages for viewers."""

    def __init__(self) -> None:
        self._frames = Frames()

    def show(self, update: Record) -> Iterator[Message]:
        """Messages about one update of the estimate."""
        if isinstance(update, Transform):
            self._frames.add(update)
            if self._frames.is_leaf(update.child_frame_id):  # the body; the message holds all other frames, too
                yield FRAMES, self._frames.tree(update.stamp_ns)
        elif isinstance(update, StatusRecord):
            if update.state == State.LOST:
                self._frames.detach_from_map()
            yield LOG, LogMessage(update.stamp_ns, update.level, f"{update.state.lower()}: {update.message}")
        elif isinstance(update, LoopClosureRecord) and update.inserted:
            text = f"loop closed: keyframe {update.query_keyframe_id} with {update.reference_keyframe_id}"
            yield LOG, LogMessage(update.stamp_ns, "info", text)
