"""The report of a fleet: where each log joined, or why it did not; the same bytes for the same fleet."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from logs.storage.placement import write_text
from slam.fleet.fleet import CityMap, Fleet
from slam.fleet.logs import FleetLog
from slam.fleet.presence import REPORTED
from slam.object_map.map_summary import summarize_map

REPORT_NAME = "report.json"
STATES = ("joined", "alone", "not mapped", "repeated")


def fleet_report(fleet: Fleet) -> dict[str, Any]:
    """The report as JSON: of the logs and of the parts of the map; and in figures."""
    logs = [{"log": log.name, "sha256": log.sha256, **_of_log(fleet, log)} for log in fleet.logs]
    parts = [_of_map(each) for each in fleet.maps if each.file]
    states = Counter(log["status"] for log in logs)
    of_map = {f"map_{key}": value for key, value in parts[0].items() if key != "map"} if parts else {}
    return {
        "logs": logs,
        "figures": {
            **{state.replace(" ", "_"): states[state] for state in STATES},
            "parts": len(parts),
            "warnings": sum(len(log.get("notes", ())) for log in logs),
            **of_map,
        },
        "parts": parts,
        "changes": len(fleet.maps[0].changes) if fleet.maps else 0,
    }


def write_report(folder: Path, fleet: Fleet) -> dict[str, Any]:
    """Write the report, which is returned, into the folder of a fleet.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    report = fleet_report(fleet)
    write_text(folder / REPORT_NAME, json.dumps(report, indent=1) + "\n")
    return report


def _of_log(fleet: Fleet, log: FleetLog) -> dict[str, Any]:
    session = fleet.sessions[log.sha256]
    first = next(each for each in fleet.logs if each.sha256 == log.sha256)
    if first is not log:
        return {"status": "repeated", "reason": f"the same log as {first.name}"}
    if not session.is_mapped:
        return {"status": "not mapped", "reason": session.reason}
    number = fleet.order.index(log.sha256)
    city_map = next(each for each in fleet.maps if number in each.part.visits)
    return {
        "status": "alone" if number in fleet.alone else "joined",
        "reason": fleet.alone.get(number, ""),
        "map": city_map.file,
        "travel_m": session.travel_m,
        "landmarks": session.landmarks,
        "notes": session.notes,
    }


def _of_map(city_map: CityMap) -> dict[str, Any]:
    part = city_map.part
    return {
        "map": city_map.file,
        "logs": len(part.visits),
        "landmarks": len(part.objects.ids),
        "landmarks_of_logs": sum(len(visit.landmarks) for visit in part.visits.values()),
        "present": int(np.count_nonzero(city_map.presence.present >= REPORTED)),
        "median_sigma_m": round(summarize_map(part.saved)["median_sigma_m"], 3),
        "hazard_per_day": city_map.presence.hazard_per_day,
        "changes": len(city_map.changes),
    }
