"""Messages for viewers beside the map: frames and texts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from logs.messages import FrameTree, LogMessage, LoopClosureRecord, Record, StatusRecord, Transform
from slam.display.map_topics import MAP_FRAME, Message
from slam.localization.state import State

FRAMES, LOG = "/tf", "/slam/log"


class Frames:
    """The frames that are known; each message holds all of them, so that a viewer needs no other."""

    def __init__(self) -> None:
        self._known: dict[str, Transform] = {}  # by the child

    def add(self, transform: Transform) -> None:
        """Replace the transform of its child frame."""
        if transform.child_frame_id != transform.parent_frame_id:
            self._known[transform.child_frame_id] = transform

    def detach_from_map(self) -> None:
        """Remove the odometry from the map."""
        self._known = {child: each for child, each in self._known.items() if each.parent_frame_id != MAP_FRAME}

    def is_leaf(self, frame_id: str) -> bool:
        """Whether that frame is the parent of no other."""
        return all(each.parent_frame_id != frame_id for each in self._known.values())

    def tree(self, stamp_ns: int) -> FrameTree:
        """All frames, stamped with that time."""
        return FrameTree(stamp_ns, tuple(replace(each, stamp_ns=stamp_ns) for each in self._known.values()))


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
