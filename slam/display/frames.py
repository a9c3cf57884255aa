"""One tree of frames: map, odometry, body, sensors."""

from __future__ import annotations

from dataclasses import replace

from logs.messages import FrameTree, Transform

MAP_FRAME = "map"


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
