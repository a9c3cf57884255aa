"""dslam info."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import InputLog, Json, Topics, parse_topics

if TYPE_CHECKING:
    from rich.table import Table

    from logs.summary import LogSummary, TopicSummary

_MOST_CLASSES = 12
_LONGEST_VALUE = 300


def info(
    log: InputLog,
    json: Json = False,
    closures: Annotated[bool, typer.Option("--closures", help="Loop-closure candidates by verdict.")] = False,
    topics: Topics = None,
) -> None:
    """Tell what a log holds, and what a replay would use of it or why it cannot.

    Example: dslam info drive.mcap --topic odometry=/wheel_odometry
    """
    from logs.summary import summarize

    chosen = parse_topics(topics)
    summary = summarize(log, chosen)
    from tools import console

    if json:
        console.show_json(_plain(summary))
    else:
        _show(summary, closures=closures)


def _plain(summary: LogSummary) -> dict[str, Any]:
    plain = asdict(summary)
    plain["selection"] = None if summary.selection is None else _selected(summary)
    return {**plain, "duration_s": summary.duration_s}


def _selected(summary: LogSummary) -> dict[str, list[str]]:
    return {topic: list(kinds) for topic, kinds in summary.selection.kinds.items()} if summary.selection else {}


def _show(summary: LogSummary, *, closures: bool) -> None:
    from tools import console

    head = f"{summary.path}: {summary.duration_s:.1f} s, {summary.size_bytes / 1e6:.2f} MB"
    if summary.odometry_length_m is not None:
        head += f", {summary.odometry_length_m:.0f} m of odometry"
    console.show(head, "", _topic_table(summary), "")
    rows: dict[str, str] = {}
    if summary.class_counts:
        classes = list(summary.class_counts.items())
        more = f", and {len(classes) - _MOST_CLASSES} more classes" if len(classes) > _MOST_CLASSES else ""
        rows["objects"] = ", ".join(f"{name} {count}" for name, count in classes[:_MOST_CLASSES]) + more
    faults = [f"{topic.topic}: {text}" for topic in summary.topics if (text := _faults(topic))]
    if faults:
        rows["gaps, order"] = "\n".join(faults)
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
        rows |= {f"{name}: {key}": _shortened(name, key, value) for key, value in values.items()}
    console.show(console.pairs(rows))
    if closures:
        console.show("", _closure_table(summary) if summary.closures else "no loop-closure candidate in the log")


def _obstacle(summary: LogSummary) -> str:
    if "dslam" in summary.metadata:
        return "this is the map of another log; replay that one"
    return summary.obstacle.partition(" Topics of the log:")[0]  # they stand above


def _shortened(name: str, key: str, value: str) -> str:
    """Metadata for people: of a configuration only what is not the default."""
    if key != "configuration":
        return value if len(value) <= _LONGEST_VALUE else f"{value[:_LONGEST_VALUE]} ... (--json shows all)"
    from slam.config import Config
    from slam.config_tree import changes
    from slam.simulation.config import SimulationConfig

    changed = changes(SimulationConfig() if name == "simulation" else Config(), value)
    return "defaults" + (f", but {', '.join(changed)}" if changed else "")


def _topic_table(summary: LogSummary) -> Table:
    from tools import console

    table = console.grid({"topic": False, "messages": True, "Hz": True, "schema": False, "frames": False})
    table.columns[0].no_wrap = True
    for topic in summary.topics:
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.1f}"
        frames = ", ".join(topic.frames)
        table.add_row(topic.topic, str(topic.message_count), rate, topic.schema_name, frames)
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

    table = console.grid({"verdict": False, "stage": False, "reason": False, "candidates": True}, "Loop closures")
    for count in summary.closures:
        table.add_row("accepted" if count.accepted else "rejected", count.stage, count.reason, str(count.count))
    return table
