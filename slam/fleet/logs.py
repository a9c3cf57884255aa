"""The logs of a fleet, by their content."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from logs.container.json_text import parse_json
from logs.digest import file_sha256
from logs.storage.placement import write_text
from slam.common.errors import FleetError

MEMBERS_NAME = "logs.json"


@dataclass(frozen=True, slots=True)
class FleetLog:
    """A log by the name that people know, and where it is; ``sha256``: of its content, empty until it is computed."""

    name: str
    path: Path
    sha256: str = ""


def find_logs(sources: Sequence[str]) -> list[FleetLog]:
    """Logs by their paths, each once, in that order.

    Raises:
        FleetError: a log that is not there.
    """
    logs = [FleetLog(name, Path(name)) for name in dict.fromkeys(sources)]
    for log in logs:
        if not log.path.exists():
            raise FleetError(f"there is no log {log.path}; check the path")
    return logs


def add_logs(folder: Path, named: Sequence[FleetLog], *, only: bool = False) -> list[FleetLog]:
    """The logs of the fleet in a folder, which keeps the list of them: those of earlier runs, then the ``named`` ones.

    Logs are distinguished by their content: another content under a known name gets a name of its own. A log of an
    earlier run need not be there any more, as long as its session is kept.

    Args:
        folder: of the fleet.
        named: logs of this run.
        only: leave out those of earlier runs that are not named.

    Raises:
        FleetError: no log at all, or a list that cannot be read.
        LogError: the list cannot be written.
    """
    named = [replace(log, sha256=file_sha256(log.path)) for log in named]
    earlier = read_members(folder)
    contents = {log.sha256 for log in named}
    members = [log for log in earlier if log.sha256 in contents or not only]
    for log in named:
        if (log.name, log.sha256) not in {(each.name, each.sha256) for each in members}:
            is_taken = any(each.name == log.name for each in members)
            members.append(replace(log, name=f"{log.name}@{log.sha256[:8]}") if is_taken else log)
    members = list({(each.name, each.sha256): each for each in members}.values())
    if not members:
        raise FleetError("no log was given; give at least one")
    entries = [{"name": log.name, "path": os.fspath(log.path.absolute()), "sha256": log.sha256} for log in members]
    write_text(folder / MEMBERS_NAME, json.dumps(entries, indent=1) + "\n")
    return members


def read_members(folder: Path) -> list[FleetLog]:
    """The logs of the fleet in a folder; none where no fleet is.

    Raises:
        FleetError: the list of them cannot be read.
    """
    path = folder / MEMBERS_NAME
    if not path.exists():
        return []
    try:
        entries = parse_json(path.read_text(encoding="utf-8"))
        return [FleetLog(str(each["name"]), Path(each["path"]), str(each["sha256"])) for each in entries]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise FleetError(f"the list of logs {path} cannot be read ({error}); remove it and name all logs") from error
