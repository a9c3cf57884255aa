"""dslam info."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools import console
from tools.arguments import InputLog, Json, Settings, Topics, parse_topics

if TYPE_CHECKING:
    from logs.messages import LoopClosureRecord
    from logs.summary import LogSummary, TopicSummary

_NUMBER = re.compile(r"(?:(?<!\w)-)?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
REPLAYED = "dslam"
"""Metadata of a log that a replay wrote."""
_MAP = "dslam_map"
"""Metadata of a saved map."""


def info(
    log: InputLog,
    json: Json = False,
    closures: Annotated[bool, typer.Option("--closures", help="Loop-closure candidates and their decisions.")] = False,
    keyframe: Annotated[
        int | None,
        typer.Option(metavar="ID", help="Only the candidates of this query keyframe; implies --closures.", min=0),
    ] = None,
    topics: Topics = None,
    settings: Settings = None,
) -> None:
    """Show what a log holds: topics, rates, clocks, frames, and what a replay would use or why it cannot.

    Example: dslam info drive.mcap --topic odometry=/wheel_odometry

    Why was a loop not closed? dslam info map.mcap --closures, then --keyframe 812
    """
    from logs.container.json_text import plain
    from logs.summary import summarize

    limits = None
    if settings:
        from slam.common.config import load_config

        limits = load_config(None, settings).reading_limits
    summary = summarize(log, parse_topics(topics), limits)
    candidates = [c for c in summary.closure_candidates if keyframe in (None, c.query_keyframe_id)]
    wanted = closures or keyframe is not None
    about_map = summary.metadata.get(_MAP)
    saved = {} if about_map is None else _describe_map(log, about_map)
    if json:
        told = plain(summary) | {"selection": summary.selection.kinds, "duration_s": summary.duration_s}
        told |= {"map": saved} if saved else {}
        del told["closure_candidates"]
        if wanted:
            told["closure_candidates"] = [
                {"time_s": summary.time_s(each.stamp_ns), **plain(each)} for each in candidates
            ]
        console.show_json(told)
        return
    if keyframe is None:
        head = f"{summary.path}: {summary.duration_s:.1f} s, {summary.size_bytes / 1e6:.2f} MB"
        rows = _rows(summary) | (_rows_of_map(log, saved) if saved else {})
        console.show(head, "", console.table(_topics(summary), texts=("schema", "frame")), "", console.pairs(rows))
    if closures and keyframe is None:
        decisions = Counter((_decision(c.accepted), c.stage, _NUMBER.sub("#", c.reason)) for c in candidates)
        counts = [
            {"decision": decision, "stage": stage, "reason": reason, "candidates": str(count)}
            for (decision, stage, reason), count in decisions.most_common(console.MAX_LISTED)
        ]
        console.show("", console.table(counts, texts=("stage", "reason"), title="Loop closures"), "")
    if wanted:
        shown = [_candidate(summary, each) for each in candidates[: console.MAX_LISTED]]
        table = console.table(shown, texts=("decision", "stage", "reason"), title="Candidates by query keyframe")
        console.show(table if shown else "no loop-closure candidate")
        if more := len(candidates) - len(shown):
            console.show(f"and {more} more: --keyframe ID lists those of one query keyframe, --json all")


def _rows(summary: LogSummary) -> dict[str, str]:
    """What is in a log beside its topics, by names for people."""
    is_mapped, status = REPLAYED in summary.metadata, summary.status
    measured = [topic for topic in summary.topics if not (is_mapped and topic.topic.startswith(("/slam/", "/tf")))]
    uses = "\n".join(f"{topic} as {', '.join(kinds)}" for topic, kinds in summary.selection.kinds.items())
    listed = {
        "landmarks" if _is_map(summary) else "objects": _classes(summary),
        "frames": "" if is_mapped else "\n".join(console.first(list_edges(summary.topics))),
        "not placed": "" if is_mapped else "\n".join(find_faults(summary)),
        "gaps, order": "\n".join(f"{topic.topic}: {text}" for topic in measured if (text := _faults(topic))),
        "replay uses": uses,
        "no replay": "" if uses else _obstacle(summary),
        "lost": ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in summary.counters.items()),
        "status": f"{status.level}: {status.message}" if status else "",
        "counters": ", ".join(f"{name} {count}" for name, count in status.counters.items()) if status else "",
    }
    for name, values in summary.metadata.items():
        if name != "rosbag2":  # a copy of metadata.yaml, which says what stands above
            # Longer values, such as a whole configuration, are in the JSON only.
            listed |= {f"{name}: {key}": text for key, text in values.items() if len(text) <= 300}
    return {name: text for name, text in listed.items() if text}


def _is_map(summary: LogSummary) -> bool:
    return REPLAYED in summary.metadata or _MAP in summary.metadata


def _classes(summary: LogSummary) -> str:
    """Numbers of detections by class; of a map, whose markers are counted as such, and of the output of a replay those
    of landmarks.
    """
    counts = list(summary.class_counts.items())
    if REPLAYED in summary.metadata or (_is_map(summary) and not counts):
        from logs.errors import LogError
        from slam.common.errors import InputDataError
        from slam.library import read_map

        try:
            counts = Counter(read_map(summary.path).labels).most_common()
        except (InputDataError, LogError):
            counts = []
    return ", ".join(console.first([f"{name} {count}" for name, count in counts], " classes"))


def _obstacle(summary: LogSummary) -> str:
    if _MAP in summary.metadata:
        return "this is a saved map, not a drive; give it to replay or relocalize by --map"
    if REPLAYED in summary.metadata:
        return "this is the map of another log; replay that log"
    return summary.obstacle.partition(" Topics of the log:")[0]  # they stand above


def _topics(summary: LogSummary) -> list[dict[str, str]]:
    """A row for each topic. Times count from the first stamp of the odometry, or else from the first message."""
    return [
        {
            "topic": topic.topic,
            "messages": str(topic.message_count),
            "Hz": _number(topic.rate_hz, ".1f"),
            "length m": _number(topic.length_m, ".0f"),
            "from s": f"{summary.time_s(topic.first_ns):.1f}" if topic.message_count else "",
            "to s": f"{summary.time_s(topic.last_ns):.1f}" if topic.message_count else "",
            "schema": topic.schema_name,
            "frame": "" if topic.frame_edges else ", ".join(topic.frames),
        }
        for topic in summary.topics
    ]


def _faults(topic: TopicSummary) -> str:
    parts = {
        f"{topic.gap_count} gaps, the longest {topic.longest_gap_s:.1f} s": topic.gap_count,
        f"{topic.duplicate_stamps} duplicate stamps": topic.duplicate_stamps,
        f"{topic.out_of_order_stamps} stamps out of order": topic.out_of_order_stamps,
    }
    return "; ".join(text for text, count in parts.items() if count)


def _candidate(summary: LogSummary, candidate: LoopClosureRecord) -> dict[str, str]:
    return {
        "query": str(candidate.query_keyframe_id),
        "reference": str(candidate.reference_keyframe_id),
        "time s": f"{summary.time_s(candidate.stamp_ns):.1f}",
        "score": f"{candidate.score:.3g}",
        "LLR": _number(candidate.log_likelihood_ratio),
        "penalty": _number(candidate.odometry_penalty),
        "inliers": str(candidate.inlier_count),
        "decision": _decision(candidate.accepted),
        "stage": candidate.stage,
        "reason": candidate.reason,
    }


def _number(value: float | None, spec: str = ".3g") -> str:
    return "" if value is None else format(value, spec)


def _decision(accepted: bool) -> str:
    return "accepted" if accepted else "rejected"


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


def _describe_map(path: Path, about: Mapping[str, str]) -> dict[str, Any]:
    """The map for JSON: its summary, or why it cannot be used; ``about``: its metadata."""
    import numpy as np

    from slam.common.errors import SavedMapError
    from slam.object_map.map_io import IMPORTED, load_map
    from slam.object_map.map_summary import summarize_map

    usable = {"usable": True, "fault": ""}
    try:
        if about.get("kind") != IMPORTED:
            return usable | summarize_map(load_map(path))
        from slam.place_recognition.imported_map import load_imported_map

        imported = load_imported_map(path)
    except SavedMapError as error:
        return {"usable": False, "fault": str(error)}
    width_m, height_m = np.ptp(imported.positions[:, :2], axis=0).tolist()
    return usable | {
        "kind": "imported",
        "landmark_count": len(imported),
        "sigma_m": imported.sigma_m,
        "width_m": width_m,
        "height_m": height_m,
        "pair_count": len(imported.pairs),
        "latitude_deg": imported.georeference and imported.georeference.latitude_deg,
        "longitude_deg": imported.georeference and imported.georeference.longitude_deg,
    }


def _rows_of_map(path: Path, described: dict[str, Any]) -> dict[str, str]:
    """What a saved map is, and the commands that use it."""
    if not described["usable"]:
        return {"saved map": f"cannot be used: {described['fault']}"}
    return {
        **console.texts({name: value for name, value in described.items() if type(value) in (int, float)}),
        "to localize in it": f"dslam relocalize LOG --map {path} -o OUT.mcap",
        "to extend it": f"dslam replay LOG -o OUT.mcap --map {path} --save-map NEW.mcap",
    }
