"""Texts and frames for viewers, beside the estimates."""

import numpy as np

from logs.messages import LoopClosureRecord, Record, StatusRecord, Transform
from slam.log_mapper import OutputLog


class Viewed:
    """An output log of which only views are taken."""

    def __init__(self) -> None:
        self.topics: dict[str, list[Record]] = {}
        self.log = OutputLog([lambda topic, record, _: self.topics.setdefault(topic, []).append(record)])

    def parents(self, *updates: Record) -> list[dict[str, str]]:
        """Parents of the frames, by their children, in each message about frames that comes of these updates."""
        before = len(self.topics.get("/tf", []))
        self.log.write_updates(updates, 0)
        trees = self.topics.get("/tf", [])[before:]
        return [{each.child_frame_id: each.parent_frame_id for each in tree.transforms} for tree in trees]


def test_status_and_closures_are_shown_as_text() -> None:
    viewed = Viewed()
    closure = LoopClosureRecord(2, 8, 3, accepted=True, stage="accepted", reason="", inserted=True)
    viewed.log.write_updates((StatusRecord(1, "MAPPING", "info", "first odometry"), closure), 0)
    texts = [record.text for record in viewed.topics["/slam/log"]]
    assert texts == ["mapping: first odometry", "loop closed: keyframe 8 with 3"]


def test_lost_robot_is_not_in_the_map() -> None:
    viewed = Viewed()
    assert len(viewed.parents(Transform(0, "map", "odom", np.eye(4)))) == 1
    assert viewed.parents(Transform(1, "odom", "base_link", np.eye(4))) == [{"odom": "map", "base_link": "odom"}]
    assert viewed.parents(Transform(1, "map", "odom", np.eye(4))) == []  # told with the body
    assert viewed.parents(StatusRecord(2, "LOST", "warning", "")) == []
    assert viewed.parents(Transform(3, "odom", "base_link", np.eye(4))) == [{"base_link": "odom"}]
