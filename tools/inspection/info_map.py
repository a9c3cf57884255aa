"""dslam info, of a saved map."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tools.inspection import MAX_LISTED

if TYPE_CHECKING:
    from slam.place_recognition.imported_map import ImportedMap

METADATA = "dslam_map"
"""What makes a log a saved map."""
SHOWN = ("format_version", "gravity", "drives", "version")
"""What of it :func:`show_map` tells."""
OBSTACLE = "this is a saved map, not a drive; give it to replay or relocalize by --map"
_FIRST_DATE_NS = 10**17
"""Stamps before that, in 1973, count from the start of something else."""


def plain_map(path: Path) -> dict[str, Any]:
    """The map for JSON: its summary, or why it cannot be used."""
    imported, summary, fault = _read(path)
    if imported is not None:
        return {"usable": True, "fault": "", **_plain_imported(imported)}
    return {"usable": summary is not None, "fault": fault, **(summary or {})}


def show_map(path: Path, now: datetime) -> None:
    """Print what a saved map is, and what a drive could do with it."""
    from tools import console

    imported, summary, fault = _read(path)
    if imported is not None:
        console.show(console.pairs(_imported_rows(path, imported)), "")
        return
    if summary is None:
        console.show(console.pairs({"saved map": f"cannot be used: {fault}"}), "")
        return
    rows = {
        "saved map": f"format version {summary['format_version']}; {summary['gravity']}",
        "landmarks": f"{summary['landmark_count']} confirmed, of {len(summary['classes'])} classes "
        f"(vocabulary of {summary['vocabulary_size']}); standard deviation {summary['median_sigma_m']:.2f} m in the "
        "median, in the plane, from the origin of the map",
        "keyframes": f"{summary['keyframe_count']}, connected by {summary['odometry_edge_count']} steps of odometry, "
        f"{summary['closure_count']} closures and {summary['observation_count']} observations of landmarks",
        "extent": f"{summary['width_m']:.0f} m x {summary['height_m']:.0f} m (x and y); "
        f"{summary['path_m']:.0f} m driven",
        "drives": "\n".join(_drive(drive) for drive in summary["drives"]),
        "last drive": when(summary["stamp_ns"], now),
        "descriptors": "computed when the map is loaded, by the configured descriptor; that of the last drive was "
        f"{summary['descriptor'] or 'not recorded'}",
        "to extend it": f"dslam replay LOG -o OUT.mcap --map {path} --save-map NEW.mcap",
        "to localize in it": f"dslam relocalize LOG --map {path} -o OUT.mcap",
    }
    console.show(console.pairs(rows), "", _class_table(summary), "")


def _read(path: Path) -> tuple[ImportedMap | None, dict[str, Any] | None, str]:
    """An imported map, or the summary of one that was driven, or why it cannot be used."""
    from logs.reader import LogReader
    from slam.common.errors import SavedMapError
    from slam.object_map.map_io import IMPORTED, load_map

    with LogReader(path) as reader:
        kind = reader.metadata().get(METADATA, {}).get("kind")
    try:
        if kind == IMPORTED:
            from slam.place_recognition.imported_map import load_imported_map

            return load_imported_map(path), None, ""
        from slam.object_map.map_summary import summarize_map

        return None, summarize_map(load_map(path)), ""
    except SavedMapError as error:
        return None, None, str(error)


def _plain_imported(imported: ImportedMap) -> dict[str, Any]:
    import numpy as np

    low, high = imported.positions[:, :2].min(axis=0), imported.positions[:, :2].max(axis=0)
    counts = np.bincount(imported.classes, minlength=len(imported.vocabulary)).tolist()
    georeference = imported.georeference
    return {
        "kind": "imported",
        "landmark_count": len(imported),
        "class_counts": dict(zip(imported.vocabulary, counts, strict=True)),
        "sigma_m": imported.sigma_m,
        "extent_m": (high - low).tolist(),
        "quad_count": len(imported.quads),
        "origin": None if georeference is None else [georeference.latitude_deg, georeference.longitude_deg],
        "source": imported.metadata.get("source", ""),
    }


def _imported_rows(path: Path, imported: ImportedMap) -> dict[str, str]:
    plain = _plain_imported(imported)
    frequent = sorted(plain["class_counts"].items(), key=lambda pair: -pair[1])
    classes = ", ".join(f"{name} {count}" for name, count in frequent[:MAX_LISTED])
    width_m, height_m = plain["extent_m"]
    origin = plain["origin"]
    return {
        "imported map": f"from {plain['source'] or 'an unknown source'}; without a trajectory",
        "landmarks": f"{len(imported)} of {len(frequent)} classes: {classes}",
        "accuracy": f"standard deviation of {imported.sigma_m:g} m",
        "index": f"{plain['quad_count']} quads of neighbouring landmarks",
        "extent": f"{width_m:.0f} m x {height_m:.0f} m (x and y)",
        "origin": "unknown" if origin is None else f"latitude {origin[0]:.6f}, longitude {origin[1]:.6f}",
        "to localize in it": f"dslam relocalize LOG --map {path} -o OUT.mcap",
        "to extend it": f"dslam replay LOG -o OUT.mcap --map {path}",
    }


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


def _class_table(summary: dict[str, Any]) -> Any:
    from tools import console

    table = console.grid({"class": False, "landmarks": True, "median sigma m": True}, "Landmarks by class")
    for each in summary["classes"][:MAX_LISTED]:
        table.add_row(each["label"], str(each["landmark_count"]), f"{each['median_sigma_m']:.3f}")
    if rest := summary["classes"][MAX_LISTED:]:
        table.add_row(f"{len(rest)} others", str(sum(each["landmark_count"] for each in rest)), "")
    return table
