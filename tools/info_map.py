"""dslam info, of a saved map."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slam.object_map.map_summary import MapSummary

METADATA = "dslam_map"
"""What makes a log a saved map."""
SHOWN = ("format_version", "gravity", "drives", "version")
"""What of it :func:`show_map` tells."""
OBSTACLE = "this is a saved map, not a drive; give it to replay or relocalize by --map"
_MOST_CLASSES = 20
_FIRST_DATE_NS = 10**17
"""Stamps before that, in 1973, count from the start of something else."""


def plain_map(path: Path) -> dict[str, Any]:
    """The map for JSON: its summary, or why it cannot be used."""
    summary, fault = _summarize(path)
    return {"usable": summary is not None, "fault": fault, **(asdict(summary) if summary is not None else {})}


def show_map(path: Path, now: datetime) -> None:
    """Print what a saved map is, and what a drive could do with it."""
    from tools import console

    summary, fault = _summarize(path)
    if summary is None:
        console.show(console.pairs({"saved map": f"cannot be used: {fault}"}), "")
        return
    rows = {
        "saved map": f"format version {summary.format_version}; {summary.gravity}",
        "landmarks": f"{summary.landmark_count} confirmed, of {len(summary.classes)} classes "
        f"(vocabulary of {summary.vocabulary_size}); standard deviation {summary.median_sigma_m:.2f} m in the median, "
        "in the plane, from the origin of the map",
        "keyframes": f"{summary.keyframe_count}, tied by {summary.odometry_edge_count} steps of odometry, "
        f"{summary.closure_count} closures and {summary.observation_count} observations of landmarks",
        "extent": f"{summary.width_m:.0f} m x {summary.height_m:.0f} m (x and y); {summary.path_m:.0f} m driven",
        "drives": "\n".join(_drive(drive) for drive in summary.drives),
        "last drive": when(summary.stamp_ns, now),
        "descriptors": "none stored: they are computed when the map is loaded, so any can be configured; that of the "
        f"last drive was {summary.descriptor or 'not told'}",
        "to go on": f"dslam replay LOG -o OUT.mcap --map {path} --save-map NEW.mcap",
        "to find a robot": f"dslam relocalize LOG --map {path} -o OUT.mcap",
    }
    console.show(console.pairs(rows), "", _class_table(summary), "")


def _summarize(path: Path) -> tuple[MapSummary | None, str]:
    from slam.common.errors import SavedMapError
    from slam.object_map.map_io import load_map
    from slam.object_map.map_summary import summarize_map

    try:
        return summarize_map(load_map(path)), ""
    except SavedMapError as error:
        return None, str(error)


def _drive(drive: dict[str, str]) -> str:
    version = drive["version"] or "not known"
    return f"input {drive['input_sha256'][:12] or 'not known'}, by version {version}"


def when(stamp_ns: int, now: datetime) -> str:
    """When the last drive ended, for people."""
    if stamp_ns < _FIRST_DATE_NS:
        return f"ended at {stamp_ns * 1e-9:.1f} s of its own clock"
    ended = datetime.fromtimestamp(stamp_ns * 1e-9, UTC)
    days = (now - ended).days
    since = f"{days // 365} years ago" if days >= 730 else f"{days} days ago"
    return f"ended {ended:%Y-%m-%d %H:%M} UTC, {since}" if days >= 0 else f"ended {ended:%Y-%m-%d %H:%M} UTC"


def _class_table(summary: MapSummary) -> Any:
    from tools import console

    table = console.grid({"class": False, "landmarks": True, "median sigma m": True}, "Landmarks by class")
    for each in summary.classes[:_MOST_CLASSES]:
        table.add_row(each.label, str(each.landmark_count), f"{each.median_sigma_m:.3f}")
    if rest := summary.classes[_MOST_CLASSES:]:
        table.add_row(f"{len(rest)} others", str(sum(each.landmark_count for each in rest)), "")
    return table
