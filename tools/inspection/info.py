"""dslam info."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import InputLog, Json, Settings, Topics, parse_topics
from tools.inspection import MAX_LISTED, frames, info_map

if TYPE_CHECKING:
    from rich.table import Table

    from logs.container.limits import ReadingLimits
    from logs.messages import LoopClosureRecord
    from logs.summary import LogSummary, TopicSummary

METADATA = "dslam"
"""Topics by which an output of a replay is recognised."""
_OWN_TOPICS = ("/slam/", "/tf")
_CANDIDATE = (
    *("stamp_ns", "query_keyframe_id", "reference_keyframe_id", "reference_stamp_ns", "accepted", "inserted", "stage"),
    *("reason", "inlier_count", "retrieval_distance", "inlier_fraction", "score", "log_likelihood_ratio"),
    *("odometry_penalty", "posterior_log_odds", "best_rival_log_likelihood_ratio", "seed_query_keyframe_id"),
    "represented_by_keyframe_id",
)
_MAX_VALUE_LENGTH = 300


def info(
    log: InputLog,
    json: Json = False,
    closures: Annotated[bool, typer.Option("--closures", help="Loop-closure candidates and their decisions.")] = False,
    keyframe: Annotated[
        int | None,
        typer.Option(metavar="ID", help="Only the candidates of this query keyframe; implies --closures.", min=0),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help=f"List all candidates, not only {MAX_LISTED}; implies --closures.")
    ] = False,
    topics: Topics = None,
    settings: Settings = None,
) -> None:
    """Show what a log holds: topics, rates, clocks, the tree of frames, and what a replay would use or why it cannot.

    Example: dslam info drive.mcap --topic odometry=/wheel_odometry

    Why was a loop not closed? dslam info map.mcap --closures, then --keyframe 812
    """
    from logs.summary import summarize

    chosen = parse_topics(topics)
    summary = summarize(log, chosen, _limits(settings))
    from tools import console

    wanted = closures or every or keyframe is not None
    candidates = [c for c in summary.closure_candidates if keyframe in (None, c.query_keyframe_id)]
    is_map = info_map.METADATA in summary.metadata
    if json:
        listed = {"closure_candidates": [_plain_candidate(summary, c) for c in candidates]} if wanted else {}
        plain_map = {"map": info_map.plain_map(log)} if is_map else {}
        console.show_json({**_plain(summary), **plain_map, **listed})
        return
    if keyframe is None:
        _show(summary)
        if is_map:
            info_map.show_map(log)
    if wanted:
        _show_closures(summary, candidates, keyframe, most=len(candidates) if every else MAX_LISTED)


def _limits(settings: Sequence[str] | None) -> ReadingLimits | None:
    """The limits of reading a log that differ from the defaults."""
    if not settings:
        return None
    from slam.common.config import load_config

    return load_config(None, settings).reading_limits


def _plain(summary: LogSummary) -> dict[str, Any]:
    plain = asdict(replace(summary, closure_candidates=()))
    del plain["closure_candidates"]
    plain["selection"] = None if summary.selection is None else _selected(summary)
    return {**plain, "duration_s": summary.duration_s}


def _plain_candidate(summary: LogSummary, candidate: LoopClosureRecord) -> dict[str, Any]:
    T = candidate.T_reference_query
    return {
        "time_s": _time_s(summary, candidate),
        **{name: getattr(candidate, name) for name in _CANDIDATE},
        "T_reference_query": None if T is None else T.tolist(),
    }


def _time_s(summary: LogSummary, candidate: LoopClosureRecord) -> float:
    """Seconds from the start of the drive to the query keyframe, on the clock of the measurements."""
    first_ns = summary.first_stamp_ns
    return (candidate.stamp_ns - (summary.closure_candidates[0].stamp_ns if first_ns is None else first_ns)) * 1e-9


def _selected(summary: LogSummary) -> dict[str, list[str]]:
    return {topic: list(kinds) for topic, kinds in summary.selection.kinds.items()} if summary.selection else {}


def _show(summary: LogSummary) -> None:
    from tools import console

    head = f"{summary.path}: {summary.duration_s:.1f} s, {summary.size_bytes / 1e6:.2f} MB"
    if summary.odometry_length_m is not None:
        head += f", {summary.odometry_length_m:.0f} m of odometry"
    console.show(head, "", _topic_table(summary), "")
    rows: dict[str, str] = {}
    is_mapped = METADATA in summary.metadata
    if classes := list((_landmarks_by_class(summary) if is_mapped else summary.class_counts).items()):
        more = f", and {len(classes) - MAX_LISTED} more classes" if len(classes) > MAX_LISTED else ""
        listed = ", ".join(f"{name} {count}" for name, count in classes[:MAX_LISTED])
        rows["landmarks" if is_mapped else "objects"] = listed + more
    inputs = [topic for topic in summary.topics if not (is_mapped and topic.topic.startswith(_OWN_TOPICS))]
    if not is_mapped and (tree := frames.draw_tree(summary.topics)):
        rows["frames"] = "\n".join(tree)
    faults = [f"{topic.topic}: {text}" for topic in inputs if (text := _faults(topic))]
    if faults:
        rows["gaps, order"] = "\n".join(faults)
    if not is_mapped and (unplaced := frames.find_faults(summary)):
        rows["not placed"] = "\n".join(unplaced)
    if summary.selection is not None:
        rows["replay uses"] = "\n".join(f"{topic} as {', '.join(k)}" for topic, k in _selected(summary).items())
    else:
        rows["no replay"] = _obstacle(summary)
    if summary.counters:
        rows["lost"] = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in summary.counters.items())
    if summary.status is not None:
        rows["status"] = f"{summary.status.level}: {summary.status.message}"
        rows["counters"] = ", ".join(f"{name} {count}" for name, count in summary.status.counters.items())
    for name, values in summary.metadata.items():
        if name == "rosbag2":  # a copy of metadata.yaml, which says what stands above
            continue
        if name == info_map.METADATA:
            values = {key: value for key, value in values.items() if key not in info_map.SHOWN}
        rows |= {f"{name}: {key}": text for key, text in _about(name, values).items()}
    console.show(console.pairs(rows))


def _show_closures(
    summary: LogSummary, candidates: Sequence[LoopClosureRecord], keyframe: int | None, *, most: int
) -> None:
    from tools import console

    if not summary.closure_candidates:
        console.show("", "no loop-closure candidate in the log")
        return
    if not candidates:
        console.show(f"keyframe {keyframe} is not the query of a loop-closure candidate")
        return
    if keyframe is None:
        console.show("", _closure_table(summary), "")
    console.show(_candidate_table(summary, candidates[:most]))
    if len(candidates) > most:
        console.show(f"and {len(candidates) - most} more: --all lists them, --keyframe ID those of one query keyframe")


def _landmarks_by_class(summary: LogSummary) -> Counter[str]:
    """Of the final map; the log holds many that are on the way to it."""
    from logs.errors import LogError
    from slam.common.errors import InputDataError
    from slam.library import read_map

    try:
        return Counter(dict(Counter(read_map(summary.path).labels).most_common()))
    except (InputDataError, LogError):
        return Counter()


def _obstacle(summary: LogSummary) -> str:
    if info_map.METADATA in summary.metadata:
        return info_map.OBSTACLE
    if METADATA in summary.metadata:
        return "this is the map of another log; replay that log"
    return summary.obstacle.partition(" Topics of the log:")[0]  # they stand above


def _about(name: str, values: Mapping[str, str]) -> dict[str, str]:
    """Metadata for people: of a configuration only what is not the default."""
    about = {
        key: _shortened(value) for key, value in values.items() if key not in ("changed_settings", "configuration")
    }
    if "configuration" not in values:
        return about
    changed = values.get("changed_settings")
    if changed is None:  # a log of version 0.1.0
        changed = _changed_settings(name, values["configuration"])
    return {"configuration": "defaults" + (f", but {changed}" if changed else ""), **about}


def _shortened(value: str) -> str:
    return value if len(value) <= _MAX_VALUE_LENGTH else f"{value[:_MAX_VALUE_LENGTH]} ... (--json shows all)"


def _changed_settings(name: str, configuration: str) -> str:
    from slam.common.config import Config
    from slam.common.config_tree import changes
    from slam.simulation.config import SimulationConfig

    return ", ".join(changes(SimulationConfig() if name == "simulation" else Config(), configuration))


def _topic_table(summary: LogSummary) -> Table:
    """Times count from the first stamp of the odometry, or else from the first message."""
    from tools import console

    start_ns = summary.start_ns if summary.first_stamp_ns is None else summary.first_stamp_ns
    rows = [
        {
            "topic": topic.topic,
            "messages": str(topic.message_count),
            "Hz": _number(topic.rate_hz, ".1f"),
            "from s": f"{(topic.first_ns - start_ns) * 1e-9:.1f}" if topic.message_count else "",
            "to s": f"{(topic.last_ns - start_ns) * 1e-9:.1f}" if topic.message_count else "",
            "schema": topic.schema_name,
            "frames": ", ".join(topic.frames),
        }
        for topic in summary.topics
    ]
    table = console.table(rows, texts=("schema", "frames"))
    for column in table.columns[:1]:
        column.no_wrap = True
    return table


def _faults(topic: TopicSummary) -> str:
    parts = []
    if topic.gap_count:
        parts.append(f"{topic.gap_count} gaps, the longest {topic.longest_gap_s:.1f} s")
    if topic.duplicate_stamps:
        parts.append(f"{topic.duplicate_stamps} duplicate stamps")
    if topic.out_of_order_stamps:
        parts.append(f"{topic.out_of_order_stamps} stamps out of order")
    return "; ".join(parts)


def _closure_table(summary: LogSummary) -> Table:
    from tools import console

    counts = [(_decision(accepted=c.accepted), c.stage, c.reason, c.count) for c in summary.closures[:MAX_LISTED]]
    if rest := summary.closures[MAX_LISTED:]:
        counts.append(("", "", f"{len(rest)} other reasons (--json)", sum(count.count for count in rest)))
    rows = [
        {"decision": decision, "stage": stage, "reason": reason, "candidates": str(count)}
        for decision, stage, reason, count in counts
    ]
    return console.table(rows, texts=("stage", "reason"), title="Loop closures")


def _candidate_table(summary: LogSummary, candidates: Sequence[LoopClosureRecord]) -> Table:
    from tools import console

    rows = [
        {
            "query": str(each.query_keyframe_id),
            "reference": str(each.reference_keyframe_id),
            "time s": f"{_time_s(summary, each):.1f}",
            "score": f"{each.score:.3g}",
            "LLR": _number(each.log_likelihood_ratio),
            "penalty": _number(each.odometry_penalty),
            "inliers": str(each.inlier_count),
            "decision": _decision(accepted=each.accepted),
            "stage": each.stage,
            "reason": each.reason,
        }
        for each in candidates
    ]
    table = console.table(rows, texts=("decision", "stage", "reason"), title="Candidates by query keyframe")
    for column in table.columns[:-1]:
        column.no_wrap = True
    return table


def _number(value: float | None, spec: str = ".3g") -> str:
    return "" if value is None else format(value, spec)


def _decision(*, accepted: bool) -> str:
    return "accepted" if accepted else "rejected"
