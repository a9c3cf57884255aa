"""One tree of frames: world, map, odometry, body, sensors."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from logs.messages import FrameTree, GroundTruthPose, SlamPose, Transform
from slam.common.geometry import interpolate, invert

MAP_FRAME = "map"


class Frames:
    """The frames that are known; each message holds all of them, so that a viewer needs no other.

    The frame of the ground truth is the parent of ``map``: at the first estimate at which both are known they agree.
    """

    def __init__(self, ground_truth: Iterable[GroundTruthPose] = ()) -> None:
        """``ground_truth``: in the order of its stamps; only as much of it is read as is needed."""
        self._ground_truth = iter(ground_truth)
        self._around: tuple[GroundTruthPose, ...] = ()  # the last truth before the newest pose, and the one after it
        self._waits_for_truth = True
        self._known: dict[str, Transform] = {}  # by the child

    def add(self, transform: Transform) -> None:
        """Take in what places a frame, instead of what placed it before."""
        if transform.child_frame_id != transform.parent_frame_id:
            self._known[transform.child_frame_id] = transform

    def detach_from_map(self) -> None:
        """Forget where the odometry is in the map."""
        self._known = {child: each for child, each in self._known.items() if each.parent_frame_id != MAP_FRAME}

    def tie(self, pose: SlamPose) -> None:
        """Place ``map`` in the frame of the ground truth, if that is not done and the truth at a pose is known."""
        while self._waits_for_truth and (not self._around or self._around[-1].stamp_ns < pose.stamp_ns):
            truth = next(self._ground_truth, None)
            self._waits_for_truth = truth is not None
            if truth is not None:
                self._around = (*self._around[-1:], truth)
        if self._waits_for_truth and self._around[0].stamp_ns <= pose.stamp_ns:
            self._waits_for_truth = False
            world = self._around[0].frame_id
            if world and world != MAP_FRAME and world not in self._known:
                stamps_ns = np.array([truth.stamp_ns for truth in self._around])
                T_world_bodies = np.stack([truth.T_world_body for truth in self._around])
                T_world_body = interpolate(stamps_ns, T_world_bodies, np.array([pose.stamp_ns]))[0]
                self.add(Transform(pose.stamp_ns, world, MAP_FRAME, T_world_body @ invert(pose.T_map_body)))

    def is_leaf(self, frame_id: str) -> bool:
        """Whether nothing that is known is placed in that frame."""
        return all(each.parent_frame_id != frame_id for each in self._known.values())

    def tree(self, stamp_ns: int) -> FrameTree:
        """All frames as they are at that time."""
        return FrameTree(
            stamp_ns,
            tuple(
                Transform(stamp_ns, each.parent_frame_id, each.child_frame_id, each.T_parent_child)
                for each in self._known.values()
            ),
        )
