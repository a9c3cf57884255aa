"""The logs of a fleet, by their content."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import TypeAdapter

from logs.digest import file_sha256
from logs.records import frozen
from logs.storage.placement import write_text
from slam.common.errors import FleetError

MEMBERS_NAME = "logs.json"


@frozen
class FleetLog:
    """A log by the name that people know, where it is or was, and the ``sha256`` of its content."""

    name: str
    path: Path
    sha256: str


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
