"""What in the frames and clocks of a log keeps detections from the body."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from logs.summary import LogSummary, TopicSummary


def list_edges(topics: Sequence[TopicSummary]) -> list[str]:
    """A line for each pair of frames that topics connect: parent, child, and the topics."""
    topics_of = defaultdict[tuple[str, str], list[str]](list)
    for topic in topics:
        for edge in topic.frame_edges:
            topics_of[edge].append(topic.topic)
    return [f"{parent} -> {child}  ({', '.join(names)})" for (parent, child), names in sorted(topics_of.items())]


def find_faults(summary: LogSummary) -> list[str]:
    """Reasons why detections cannot be placed on the odometry: unconnected frames, and other clocks."""
    from logs.topics import RecordKind

    of_topic = {topic.topic: topic for topic in summary.topics}
    odometry = [of_topic[name] for name in summary.selection.topics_of(RecordKind.ODOMETRY)]
    detections = [of_topic[name] for name in summary.selection.topics_of(RecordKind.DETECTIONS)]
    bodies = {child for topic in odometry for _, child in topic.frame_edges}
    edges = [edge for topic in summary.topics for edge in topic.frame_edges]
    placed = set(bodies)
    while beside := {frame for edge in edges if not placed.isdisjoint(edge) for frame in edge} - placed:
        placed |= beside
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
