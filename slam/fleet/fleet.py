"""A fleet: logs in, one map out. What is done stays in the folder, by what it was made from, and is not done again."""

import json
import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from logs.digest import content_key
from logs.errors import LogError
from logs.records import frozen
from logs.storage.placement import write_text
from slam.common.config import Config
from slam.common.errors import FleetError, SavedMapError
from slam.common.georeference import Georeference
from slam.fleet.changes import Change, find_changes
from slam.fleet.condensed_map import condense_map
from slam.fleet.joins import accept_joins, find_joins, read_joins, why_alone, write_joins
from slam.fleet.joint_map import join_parts
from slam.fleet.part import Part, are_saved, common_metadata, load_parts, save_parts, session_part
from slam.fleet.presence import REPORTED, Presence, estimate_presence, find_passes, seen_probabilities
from slam.fleet.sessions import MAP_NAME, VERSION, FleetLog, Session, map_sessions, session_folder
from slam.formats.landmark_tables import write_points
from slam.object_map.map_io import load_map, of_rows
from slam.object_map.map_summary import summarize_map
from slam.place_recognition.imported_map import load_imported_map, make_imported_map, save_imported_map
from slam.provenance import recorded_config

logger = logging.getLogger(__name__)

BLOCK = 16
"""Sessions that are folded together, by date; as many of the latest sessions are not, at least."""

FIRST_LOG = "first_log"
"""In the metadata of a map: the digest of the log at whose start its frame is."""

REPORT_NAME = "report.json"


@frozen
class CityMap:
    """A part of the result, where its landmarks are present, and what changed. ``file``: its name, empty if it has none
    as a log that joined no other one.
    """

    part: Part
    presence: Presence
    changes: tuple[Change, ...]
    file: str


@frozen
class Fleet:
    """``logs`` in the order given; ``sessions`` by digest; ``order``: the digests of those that were mapped, by
    date: their numbers; ``alone``: by the number of a session that joined no other one the reason; ``maps``: the
    result, that of most sessions first.
    """

    logs: tuple[FleetLog, ...]
    sessions: Mapping[str, Session]
    order: tuple[str, ...]
    alone: Mapping[int, str]
    maps: tuple[CityMap, ...]


_Joined = tuple[list[Part], Mapping[int, str], Config]
"""The parts that are left, the reasons why those of one session are alone, by its number, and by what they were
compared.
"""


def map_fleet(
    logs: Sequence[FleetLog],
    folder: Path,
    config: Config,
    *,
    workers: int,
    georeference: Georeference | None,
    tell: Callable[[str], None],
) -> Fleet:
    """Map logs by themselves, find them in one another, and join them; write the maps and what changed.

    Args:
        logs: of one city, with other ones among them.
        folder: keeps what is done; takes ``map.mcap``, further parts as ``map_2.mcap`` ..., and ``changes.geojson``.
        config: of each replay.
        workers: logs that are mapped at a time.
        georeference: where the map of most sessions lies on earth; without it, that of an earlier run stays.
        tell: called with a line for each log that was mapped, and before all are joined.

    Raises:
        FleetError: no log could be mapped, or one has to be and is gone.
        LogError: a file that cannot be written.
    """
    sessions = map_sessions(logs, folder, config, workers=workers, tell=tell)
    by_date = sorted(sessions.values(), key=lambda session: (session.first_ns, session.sha256))
    mapped = [session for session in by_date if not session.reason]
    if not mapped:
        reasons = "; ".join(f"{log.name}: {sessions[log.sha256].reason}" for log in logs)
        raise FleetError(f"none of {len(logs)} logs could be mapped: {reasons}")
    tell(f"joining {len(mapped)} maps")
    order = tuple(session.sha256 for session in mapped)
    paths = [session_folder(folder, digest, config) / MAP_NAME for digest in order]
    parts, alone, compared_by = _join_sessions(paths, folder)
    first = order[parts[0].sessions[0]]
    georeference = georeference or _known_georeference(folder / MAP_NAME, first)
    maps = []
    for rank, part in enumerate(parts, start=1):
        stamps_ns = [mapped[number].first_ns for number in part.sessions]
        seen, distances_m = find_passes(part)
        presence = estimate_presence(seen, seen_probabilities(seen, distances_m), stamps_ns)
        file = "map.mcap" if rank == 1 else f"map_{rank}.mcap" if len(stamps_ns) > 1 else ""
        place = georeference if rank == 1 else None
        source = {"source": f"a fleet of {len(part.sessions)} sessions", FIRST_LOG: order[part.sessions[0]]}
        is_written = file and _save(folder / file, part, presence, compared_by, place, source)
        maps.append(CityMap(part, presence, find_changes(part, presence, stamps_ns), file if is_written else ""))
    changes = maps[0].changes
    places = np.array([change.position for change in changes]).reshape(-1, 3)
    write_points(folder / "changes.geojson", places, map(asdict, changes), georeference)
    return Fleet(tuple(logs), sessions, order, alone, tuple(maps))


def _join_sessions(paths: Sequence[Path], folder: Path) -> _Joined:
    """Join the maps of sessions, in the order of their dates; all but the latest are folded, block by block."""
    names = [path.parent.name for path in paths]
    count = max(len(paths) // BLOCK - 1, 0) * BLOCK
    blocks = [(end, folder / "folded" / content_key(*names[:end])) for end in range(BLOCK, count + 1, BLOCK)]
    done = max((row for row, (_, kept) in enumerate(blocks) if are_saved(kept)), default=0)
    known = dict[str, Part]()
    for end, kept in blocks[done:]:
        if not are_saved(kept):
            parts, _, config = _join(known, _loaded(paths, range(end - BLOCK, end)), folder)
            save_parts(kept, [replace(part, saved=condense_map(part.saved, config)) for part in parts])
        known = {f"{kept.name}/{rank}": part for rank, part in enumerate(load_parts(kept))}
    return _join(known, _loaded(paths, range(count, len(paths))), folder)


def _loaded(paths: Sequence[Path], numbers: range) -> dict[str, Part]:
    return {paths[number].parent.name: session_part(number, load_map(paths[number])) for number in numbers}


def _join(known: Mapping[str, Part], sessions: Mapping[str, Part], folder: Path) -> _Joined:
    """Join sessions with one another and with parts of earlier ones; both are named by what they were made from."""
    names, parts = [*known, *sessions], [*known.values(), *sessions.values()]
    maps = [part.saved for part in parts]
    joins = []
    for number in range(max(len(known), 1), len(parts)):
        path = folder / "joins" / f"{content_key(*names[: number + 1])}.json"
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            config = recorded_config(common_metadata(maps[: number + 1]))
            write_joins(path, find_joins(maps[number], maps[:number], config))
        joins += read_joins(path)
    config = recorded_config(common_metadata(maps))
    joined = join_parts(parts, accept_joins(joins, len(maps), config), config)
    are_alone = {part.sessions for part in joined if len(part.visits) == 1}
    alone = {
        part.sessions[0]: why_alone(number, joins, len(maps), config)
        for number, part in enumerate(parts)
        if part.sessions in are_alone
    }
    return joined, alone, config


def _known_georeference(path: Path, first: str) -> Georeference | None:
    """That of the map of an earlier run, whose frame is that of the log with the digest ``first``."""
    try:
        earlier = load_imported_map(path)
    except (LogError, SavedMapError):
        return None
    return earlier.georeference if earlier.metadata.get(FIRST_LOG) == first else None


def _save(
    path: Path,
    part: Part,
    presence: Presence,
    config: Config,
    georeference: Georeference | None,
    source: Mapping[str, str],
) -> bool:
    """Write the landmarks of a part that a session would see now as a map of tiles; returns whether they make one."""
    now = of_rows(part.objects, presence.useful >= REPORTED)
    try:
        tiles = make_imported_map(
            now.positions,
            now.labels,
            now.ids,
            sigma_m=config.calibration.objects.landmark_sigma_m,
            georeference=georeference,
            source={**source, "version": VERSION},
        )
    except SavedMapError as error:
        logger.warning("%s is not written: %s", path.name, error)
        return False
    save_imported_map(path, tiles, now)
    return True


def write_report(folder: Path, fleet: Fleet) -> dict[str, Any]:
    """Write the report into the folder of a fleet: where each log joined, or why it did not; the parts of the map; and
    figures.

    Returns:
        What is written as JSON.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    logs = [{"log": log.name, "sha256": log.sha256, **_of_log(fleet, log)} for log in fleet.logs]
    parts = [_of_map(each) for each in fleet.maps if each.file]
    states = Counter(log["status"] for log in logs)
    of_map = {f"map_{key}": value for part in parts[:1] for key, value in part.items() if key != "map"}
    report = {
        "logs": logs,
        "figures": {
            **{state.replace(" ", "_"): states[state] for state in ("joined", "alone", "not mapped", "repeated")},
            "parts": len(parts),
            "warnings": sum(len(log.get("notes", ())) for log in logs),
            **of_map,
        },
        "parts": parts,
        "changes": len(fleet.maps[0].changes) if fleet.maps else 0,
    }
    write_text(folder / REPORT_NAME, json.dumps(report, indent=1) + "\n")
    return report


def _of_log(fleet: Fleet, log: FleetLog) -> dict[str, Any]:
    session = fleet.sessions[log.sha256]
    first = next(each for each in fleet.logs if each.sha256 == log.sha256)
    if first is not log:
        return {"status": "repeated", "reason": f"the same log as {first.name}"}
    if session.reason:
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
