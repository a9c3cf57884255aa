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


def plain_map(path: Path) -> dict[str, Any]:
    """The map for JSON: its summary, or why it cannot be used."""
    from logs.reader import LogReader
    from slam.common.errors import SavedMapError
    from slam.object_map.map_io import IMPORTED, load_map

    with LogReader(path) as reader:
        kind = reader.metadata().get(METADATA, {}).get("kind")
    try:
        if kind == IMPORTED:
            from slam.place_recognition.imported_map import load_imported_map

            return {"usable": True, "fault": "", **_plain_imported(load_imported_map(path))}
        from slam.object_map.map_summary import summarize_map

        return {"usable": True, "fault": "", **summarize_map(load_map(path))}
    except SavedMapError as error:
        return {"usable": False, "fault": str(error)}


def show_map(path: Path) -> None:
    """Print what a saved map is, and the commands that use it."""
    from tools import console

    plain = plain_map(path)
    if not plain["usable"]:
        console.show(console.pairs({"saved map": f"cannot be used: {plain['fault']}"}), "")
        return
    counts = plain.get("class_counts") or {each["label"]: each["landmark_count"] for each in plain["classes"]}
    frequent = sorted(counts.items(), key=lambda pair: -pair[1])
    others = [f"and {len(frequent) - MAX_LISTED} more classes"] if len(frequent) > MAX_LISTED else []
    rows = {name.replace("_", " "): text for name, value in plain.items() if (text := _text(name, value))}
    rows["classes"] = ", ".join([*(f"{name} {count}" for name, count in frequent[:MAX_LISTED]), *others])
    rows["drives"] = "\n".join(_drive(drive) for drive in plain.get("drives", ())) or "none"
    rows["to localize in it"] = f"dslam relocalize LOG --map {path} -o OUT.mcap"
    rows["to extend it"] = f"dslam replay LOG -o OUT.mcap --map {path} --save-map NEW.mcap"
    console.show(console.pairs(rows), "")


def _text(name: str, value: object) -> str:
    """A figure of the summary for people; "" for a table of its own."""
    if name == "stamp_ns" and isinstance(value, int):
        return f"{datetime.fromtimestamp(value * 1e-9, UTC):%Y-%m-%d %H:%M:%S} UTC, by the clock of the last drive"
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return ""
    if isinstance(value, float):
        return f"{value:.6f}" if name.endswith("_deg") else f"{value:.3f}"
    return str(value)


def _plain_imported(imported: ImportedMap) -> dict[str, Any]:
    import numpy as np

    width_m, height_m = np.ptp(imported.positions[:, :2], axis=0).tolist()
    counts = np.bincount(imported.classes, minlength=len(imported.vocabulary)).tolist()
    georeference = imported.georeference
    return {
        "kind": "imported",
        "landmark_count": len(imported),
        "class_counts": dict(zip(imported.vocabulary, counts, strict=True)),
        "sigma_m": imported.sigma_m,
        "width_m": width_m,
        "height_m": height_m,
        "pair_count": len(imported.pairs),
        "latitude_deg": None if georeference is None else georeference.latitude_deg,
        "longitude_deg": None if georeference is None else georeference.longitude_deg,
        "source": imported.metadata.get("source", ""),
    }


def _drive(drive: dict[str, str]) -> str:
    version = drive["version"] or "not known"
    return f"input {drive['input_sha256'][:12] or 'not known'}, by version {version}"
