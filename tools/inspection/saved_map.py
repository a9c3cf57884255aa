"""dslam info, of a saved map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tools import console

METADATA = "dslam_map"
"""What makes a log a saved map."""


def describe(path: Path, about: Mapping[str, str]) -> dict[str, Any]:
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


def rows(path: Path, described: dict[str, Any]) -> dict[str, str]:
    """What a saved map is, and the commands that use it."""
    if not described["usable"]:
        return {"saved map": f"cannot be used: {described['fault']}"}
    return {
        **console.texts({name: value for name, value in described.items() if type(value) in (int, float)}),
        "to localize in it": f"dslam relocalize LOG --map {path} -o OUT.mcap",
        "to extend it": f"dslam replay LOG -o OUT.mcap --map {path} --save-map NEW.mcap",
    }
