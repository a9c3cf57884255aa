"""Messages for viewers beside the map: frames and texts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from logs.messages import FrameTree, LogMessage, LoopClosureRecord, Record, StatusRecord, Transform
from slam.display.map_topics import MAP_FRAME, Message
from slam.localization.state import State

FRAMES, LOG = "/tf", "/slam/log"


class DriveDisplay:
    """Turns updates of the estimate into messages for viewers.

    Each message about frames holds all that are known, so that a viewer needs no other.
    """

    def __init__(self) -> None:
        self._frames: dict[str, Transform] = {}  # by the child

    def show(self, update: Record) -> Iterator[Message]:
        """Messages about one update of the estimate."""
        if isinstance(update, Transform):
            if update.child_frame_id != update.parent_frame_id:  # as of an odometry in the frame of the map
                self._frames[update.child_frame_id] = update
            if all(each.parent_frame_id != update.child_frame_id for each in self._frames.values()):  # the body
                frames = tuple(replace(each, stamp_ns=update.stamp_ns) for each in self._frames.values())
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
