"""The tree of frames of a log, and what in it keeps detections from the body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from logs.summary import LogSummary, TopicSummary

_INDENT = "  "


def draw_tree(topics: Sequence[TopicSummary]) -> list[str]:
    """A line for each frame, below its parent, with the topic that connects the two; frames without one stand alone."""
    above = {child: (parent, topic.topic) for topic in topics for parent, child in topic.frame_edges}
    frames = {frame for topic in topics for frame in topic.frames} | {parent for parent, _ in above.values()}
    lines: list[str] = []

    def draw(frame: str, depth: int, drawn: frozenset[str]) -> None:
        topic = f"  ({above[frame][1]})" if frame in above else ""
        lines.append(f"{_INDENT * depth}{frame}{topic}")
        for child in sorted(each for each, (parent, _) in above.items() if parent == frame and each not in drawn):
            draw(child, depth + 1, drawn | {child})

    for root in sorted(frames - set(above)):
        draw(root, 0, frozenset({root}))
    return lines


def find_faults(summary: LogSummary) -> list[str]:
    """What keeps detections from being placed on the odometry: frames that nothing connects, and other clocks."""
    from logs.topics import RecordKind

    if summary.selection is None:
        return []
    of_topic = {topic.topic: topic for topic in summary.topics}
    odometry = [of_topic[name] for name in summary.selection.topics_of(RecordKind.ODOMETRY)]
    detections = [of_topic[name] for name in summary.selection.topics_of(RecordKind.DETECTIONS)]
    bodies = {child for topic in odometry for _, child in topic.frame_edges}
    placed = _connected(summary.topics, bodies)
    faults = [
        f"{topic.topic} is in the frame {frame}, which no transform connects with {', '.join(sorted(bodies))}"
        for topic in detections
        for frame in topic.frames
        if bodies and frame not in placed
    ]
    for topic in detections:
        for other in odometry:
            if topic.last_ns < other.first_ns or topic.first_ns > other.last_ns:
                apart_s = max(topic.first_ns - other.last_ns, other.first_ns - topic.last_ns) * 1e-9
                faults.append(f"{topic.topic} and {other.topic} are {apart_s:.1f} s apart: not on one clock")
    return faults


def _connected(topics: Sequence[TopicSummary], bodies: set[str]) -> set[str]:
    """The frames that a chain of transforms connects with those of the body."""
    edges = [edge for topic in topics for edge in topic.frame_edges]
    found, size = set(bodies), 0
    while size < len(found):
        size = len(found)
        found |= {frame for edge in edges if found & set(edge) for frame in edge}
    return found
