"""The tree of frames of a log, and the gaps in it between detections and body."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tools.inspection import MAX_LISTED

if TYPE_CHECKING:
    from logs.summary import LogSummary, TopicSummary

_INDENT = "  "


def draw_tree(topics: Sequence[TopicSummary]) -> list[str]:
    """A line for each frame, below its parent, with the topic that connects the two; frames without one stand alone."""
    above = {child: (parent, topic.topic) for topic in topics for parent, child in topic.frame_edges}
    children = defaultdict[str, list[str]](list)
    for child, (parent, _) in above.items():
        children[parent].append(child)
    frames = {frame for topic in topics for frame in topic.frames} | children.keys()
    lines: list[str] = []
    waiting = [(0, root) for root in sorted(frames - above.keys(), reverse=True)]
    while waiting:
        depth, frame = waiting.pop()
        topic = f"  ({above[frame][1]})" if frame in above else ""
        lines.append(f"{_INDENT * depth}{frame}{topic}")
        waiting += [(depth + 1, child) for child in sorted(children[frame], reverse=True)]
    return lines[:MAX_LISTED] + [f"and {len(lines) - MAX_LISTED} more"] * (len(lines) > MAX_LISTED)


def find_faults(summary: LogSummary) -> list[str]:
    """Reasons why detections cannot be placed on the odometry: unconnected frames, and other clocks."""
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
    neighbours = defaultdict[str, set[str]](set)
    for topic in topics:
        for parent, child in topic.frame_edges:
            neighbours[parent].add(child)
            neighbours[child].add(parent)
    found, waiting = set(bodies), set(bodies)
    while waiting:
        waiting = {each for frame in waiting for each in neighbours[frame]} - found
        found |= waiting
    return found
