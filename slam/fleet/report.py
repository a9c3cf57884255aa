"""The report of a fleet: where each log joined, or why it did not; the same bytes for the same fleet."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from logs.container.json_text import parse_json
from logs.storage.placement import write_text
from slam.common.errors import FleetError
from slam.fleet.changes import REPORTED
from slam.fleet.fleet import Fleet
from slam.fleet.logs import read_members

REPORT_NAME = "report.json"


def fleet_report(fleet: Fleet) -> dict[str, Any]:
    """The report as JSON: of the logs, of the parts of the map, and of the pairs that did not join; and in figures."""
    names = _names(fleet)
    part_of = {number: rank for rank, part in enumerate(fleet.parts) for number in part.sessions}
    first: dict[str, str] = {}
    logs = []
    for name, digest in fleet.logs.items():
        entry: dict[str, Any] = {"log": name, "sha256": digest}
        session = fleet.sessions[digest]
        if digest in first:
            entry |= {"status": "repeated", "reason": f"the same log as {first[digest]}"}
        elif not session.is_mapped:
            entry |= {"status": "not mapped", "reason": session.reason}
        else:
            entry |= _of_session(fleet, fleet.order.index(digest), part_of, names)
        first.setdefault(digest, name)
        logs.append(entry)
    parts = [_of_part(fleet, rank) for rank, name in enumerate(fleet.maps) if name]
    states = [log["status"] for log in logs]
    return {
        "logs": logs,
        "figures": {
            **{state.replace(" ", "_"): states.count(state) for state in ("joined", "alone", "not mapped", "repeated")},
            "parts": len(parts),
            "warnings": sum(len(log.get("notes", ())) for log in logs),
            **({f"map_{key}": value for key, value in parts[0].items() if key != "map"} if parts else {}),
        },
        "parts": parts,
        "refused": [
            {"logs": [_name(fleet, block, names) for block in (pair.first, pair.second)], "reason": pair.reason}
            for pair in fleet.pairs
            if not pair.accepted
        ],
        "changes": len(fleet.changes),
    }


def write_report(folder: Path, fleet: Fleet) -> None:
    """Write the report into the folder of a fleet.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    write_text(folder / REPORT_NAME, json.dumps(fleet_report(fleet), indent=1) + "\n")


def read_report(folder: Path) -> dict[str, Any]:
    """The last report of the fleet in a folder; logs that came later have the status "waiting".

    Raises:
        FleetError: no fleet is there, or a file cannot be read.
    """
    report: dict[str, Any] = {"logs": [], "figures": {}, "parts": [], "refused": [], "changes": 0}
    path = folder / REPORT_NAME
    if path.exists():
        try:
            report |= parse_json(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, TypeError) as error:
            raise FleetError(f"the report {path} cannot be read ({error}); run the fleet again") from error
    members = read_members(folder)
    if not members:
        raise FleetError(f"{folder} holds no fleet; make one by 'dslam fleet add {folder} LOG...'")
    known = {log["log"] for log in report["logs"]}
    report["logs"] += [
        {"log": log.name, "sha256": log.sha256, "status": "waiting"} for log in members if log.name not in known
    ]
    return report


def _of_session(fleet: Fleet, number: int, part_of: dict[int, int], names: list[str]) -> dict[str, Any]:
    session = fleet.sessions[fleet.order[number]]
    rank = part_of[number]
    block = next(block for block, sessions in enumerate(fleet.blocks) if number in sessions)
    joined = [
        {
            "log": _name(fleet, pair.second if pair.first == block else pair.first, names),
            "places": len(pair.joins),
            "log_odds": round(pair.log_odds, 1),
        }
        for pair in fleet.pairs
        if pair.accepted
        and block in (pair.first, pair.second)
        and part_of[fleet.blocks[pair.first][0]] == part_of[fleet.blocks[pair.second][0]]
    ]
    is_alone = len(fleet.parts[rank].sessions) == 1
    entry: dict[str, Any] = {
        "status": "alone" if is_alone else "joined",
        "reason": _why_alone(fleet, block, names) if is_alone else "",
        "map": fleet.maps[rank],
        "travel_m": session.travel_m,
        "landmarks": session.landmarks,
        "joined": joined,
        "notes": list(session.notes),
    }
    return entry


def _name(fleet: Fleet, block: int, names: list[str]) -> str:
    """What a map that was joined is called: by its log, or by how many were folded to it."""
    first, *others = fleet.blocks[block]
    return f"the map of {len(others) + 1} earlier logs" if others else names[first]


def _why_alone(fleet: Fleet, block: int, names: list[str]) -> str:
    """Why a session joined no other."""
    pairs = [pair for pair in fleet.pairs if block in (pair.first, pair.second)]
    if not pairs:
        return "none of its places was recognised in another log"
    best = max(pairs, key=lambda pair: pair.log_odds)
    other = _name(fleet, best.second if best.first == block else best.first, names)
    if best.accepted:
        return f"its joins contradict those of other logs; the best was with {other}"
    return f"the best was with {other}: {best.reason}"


def _of_part(fleet: Fleet, rank: int) -> dict[str, Any]:
    part, living = fleet.parts[rank], fleet.living[rank]
    sigmas_m = np.sqrt(np.trace(part.objects.covariances[:, :2, :2], axis1=1, axis2=2) / 2.0)
    return {
        "map": fleet.maps[rank],
        "logs": len(part.sessions),
        "landmarks": len(part.objects.ids),
        "landmarks_of_logs": sum(map(len, part.seen.values())),
        "present": int(np.count_nonzero(living.presence.present >= REPORTED)),
        "median_sigma_m": round(float(np.median(sigmas_m)), 3),
        "joins_rejected": len(part.rejected),
        "hazard_per_day": living.presence.hazard_per_day,
        "changes": len(living.changes),
    }


def _names(fleet: Fleet) -> list[str]:
    """A name for each session number: that of the first log with its content."""
    name_of: dict[str, str] = {}
    for name, digest in fleet.logs.items():
        name_of.setdefault(digest, name)
    return [name_of[digest] for digest in fleet.order]
