"""The logs of a fleet by their content, each mapped by itself in a process of its own.

A session is a function of its log and the settings.
"""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

from pydantic import TypeAdapter

from logs.digest import content_key, file_sha256
from logs.errors import LogError
from logs.records import frozen
from logs.storage.placement import write_text
from slam.common.config import Config
from slam.common.errors import FleetError, SlamError
from slam.fleet.condensed_map import condense_map
from slam.object_map.map_io import load_map, write_map
from slam.object_map.map_summary import summarize_map
from slam.provenance import recorded_config
from slam.replay import replay
from slam.sweeps.workers import compute_all

VERSION = version("descriptellation-slam")
MEMBERS_NAME, MAP_NAME, LEDGER_NAME = "logs.json", "map.mcap", "session.json"


@frozen
class FleetLog:
    """A log by the name that people know, where it is or was, and the ``sha256`` of its content."""

    name: str
    path: Path
    sha256: str


@dataclass(frozen=True, slots=True)
class Session:
    """The result of mapping a log. ``reason``: why it has no map, empty if it has one; ``first_ns``: stamp of its first
    keyframe; ``notes``: what a replay would warn of. Nothing in it depends on when or where it was mapped.
    """

    sha256: str
    reason: str
    landmarks: int = 0
    travel_m: float = 0.0
    first_ns: int = 0
    notes: tuple[str, ...] = ()


_LEDGER = TypeAdapter(Session)
_MEMBERS = TypeAdapter(list[FleetLog])


def find_logs(sources: Sequence[str]) -> list[FleetLog]:
    """Logs by their paths, each once, in that order.

    Raises:
        FleetError: a log that is not there.
        LogError: one that cannot be read.
    """
    paths = {name: Path(name) for name in sources}
    for path in paths.values():
        if not path.exists():
            raise FleetError(f"there is no log {path}; check the path")
    return [FleetLog(name, path.absolute(), file_sha256(path)) for name, path in paths.items()]


def add_logs(folder: Path, named: Sequence[FleetLog], *, only: bool = False) -> list[FleetLog]:
    """The logs of the fleet in a folder, which keeps the list of them: those of earlier runs, then the ``named`` ones.

    Logs are distinguished by their content, also under one name. A log of an earlier run need not be there any more, as
    long as its session is kept.

    Args:
        folder: of the fleet.
        named: logs of this run.
        only: leave out those of earlier runs that are not named.

    Raises:
        FleetError: no log at all, or a list that cannot be read.
        LogError: the list cannot be written.
    """
    contents = {log.sha256 for log in named}
    members = {(log.name, log.sha256): log for log in read_members(folder) if log.sha256 in contents or not only}
    for log in named:
        members.setdefault((log.name, log.sha256), log)
    if not members:
        raise FleetError("no log was given; give at least one")
    write_text(folder / MEMBERS_NAME, _MEMBERS.dump_json(list(members.values()), indent=1).decode() + "\n")
    return list(members.values())


def read_members(folder: Path) -> list[FleetLog]:
    """The logs of the fleet in a folder; none where no fleet is.

    Raises:
        FleetError: the list of them cannot be read.
    """
    path = folder / MEMBERS_NAME
    try:
        return _MEMBERS.validate_json(path.read_bytes()) if path.exists() else []
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise FleetError(f"the list of logs {path} cannot be read ({reason}); remove it and name all logs") from error


def map_sessions(
    logs: Sequence[FleetLog], folder: Path, config: Config, *, workers: int, tell: Callable[[str], None]
) -> dict[str, Session]:
    """The sessions of logs by the digests of their content; each is mapped unless the folder of the fleet has it.

    Raises:
        FleetError: a log that has to be mapped is gone.
        LogError: a result cannot be written.
    """
    sessions, waiting = dict[str, Session](), dict[str, FleetLog]()
    for log in logs:
        done = _read_session(session_folder(folder, log.sha256, config))
        if done is not None:
            sessions[log.sha256] = done
        elif not log.path.exists():
            raise FleetError(
                f"{log.name} has to be mapped, and does not exist at {log.path} any more; remove it with --only"
            )
        else:
            waiting.setdefault(log.sha256, log)
    compute = partial(map_session, folder=folder, config=config)
    outcomes = compute_all(compute, list(waiting.values()), jobs=workers)
    for finished, (log, outcome) in enumerate(outcomes, start=1):
        if outcome is None:
            reason = "the process that mapped it died, perhaps for lack of memory; add it again, with fewer --workers"
            outcome = Session(log.sha256, reason)
        sessions[log.sha256] = outcome
        result = "not mapped" if outcome.reason else f"mapped, {len(outcome.notes)} warnings"
        tell(f"{finished}/{len(waiting)} {log.path.name}: {result}")
    return sessions


def session_folder(folder: Path, sha256: str, config: Config) -> Path:
    """Where the session of a log with this digest is, in the folder of a fleet."""
    return folder / "sessions" / content_key(sha256, config.model_dump_json(), VERSION)


def map_session(log: FleetLog, folder: Path, config: Config) -> Session:
    """Map a log into its folder of a fleet: its condensed map and its ledger, which is written last."""
    target = session_folder(folder, log.sha256, config)
    scratch = target / "mapping"
    # A process that was killed leaves it behind.
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    try:
        summary = replay(log.path, scratch / "replay.mcap", config, map_path=scratch / MAP_NAME)
        saved = load_map(scratch / MAP_NAME)
        write_map(scratch / MAP_NAME, condense_map(saved, recorded_config(saved.metadata)))
        session = Session(
            sha256=log.sha256,
            reason="",
            landmarks=len(saved.objects.ids),
            travel_m=round(summarize_map(saved)["path_m"], 3),
            first_ns=int(saved.graph.keyframe_stamps_ns.min()),
            notes=summary.notes,
        )
        (scratch / MAP_NAME).replace(target / MAP_NAME)
    except (LogError, SlamError) as error:
        reason = " ".join([str(error), *getattr(error, "__notes__", ())]).replace(f"{scratch}/", "")
        session = Session(log.sha256, reason)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    write_text(target / LEDGER_NAME, _LEDGER.dump_json(session, indent=1).decode() + "\n")
    return session


def _read_session(folder: Path) -> Session | None:
    """What a finished task left in its folder; None if there is nothing, or nothing that can be used."""
    try:
        session = _LEDGER.validate_json((folder / LEDGER_NAME).read_bytes())
    except (OSError, ValueError):
        return None
    return session if session.reason or (folder / MAP_NAME).exists() else None
