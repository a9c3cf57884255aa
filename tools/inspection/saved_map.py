"""dslam info, of a saved map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tools import console

METADATA = "dslam_map"
"""What makes a log a saved map."""


def describe(path: Path) -> dict[str, Any]:
    """The map for JSON: its summary, or why it cannot be used."""
    import numpy as np

    from slam.common.errors import SavedMapError
    from slam.localization.prior_map import load_prior_map
    from slam.object_map.map_summary import summarize_map
    from slam.place_recognition.imported_map import ImportedMap

    try:
        found = load_prior_map(path)
    except SavedMapError as error:
        return {"usable": False, "fault": str(error)}
    usable = {"usable": True, "fault": ""}
    if not isinstance(found, ImportedMap):
        return usable | summarize_map(found)
    width_m, height_m = np.ptp(found.positions[:, :2], axis=0).tolist()
    return usable | {
        "kind": "imported",
        "landmark_count": len(found),
        "sigma_m": found.sigma_m,
        "width_m": width_m,
        "height_m": height_m,
        "pair_count": len(found.pairs),
        "latitude_deg": found.georeference and found.georeference.latitude_deg,
        "longitude_deg": found.georeference and found.georeference.longitude_deg,
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
