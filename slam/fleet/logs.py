"""The logs of a fleet: files, and URLs that are fetched once."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from logs.container.json_text import parse_json
from logs.digest import file_sha256
from logs.storage.placement import write_text
from logs.storage.regular_file import read_regular
from logs.writer import partial_path
from slam.common.errors import FleetError

MEMBERS_NAME = "logs.json"
_REMOTE = "://"


@dataclass(frozen=True, slots=True)
class FleetLog:
    """A log by the name that people know, and where it is; ``sha256``: of its content, empty until it is computed."""

    name: str
    path: Path
    sha256: str = ""


def find_logs(sources: Sequence[str], manifest: Path | None, cache: Path) -> list[FleetLog]:
    """Logs by path or URL, those of a manifest after the others; each once, in that order.

    Args:
        sources: as they are written; names of files are relative to the working folder.
        manifest: a text file with one a line, relative to its own folder; lines that begin with # are left out.
        cache: folder for what is fetched.

    Raises:
        FleetError: a manifest that cannot be read, a log that is not there, or a URL without fsspec.
    """
    named = dict.fromkeys([*sources, *(_listed(manifest) if manifest is not None else ())])
    return [FleetLog(name, _fetched(name, cache) if _REMOTE in name else _checked(Path(name))) for name in named]


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


def _listed(manifest: Path) -> list[str]:
    try:
        lines = [line.strip() for line in read_regular(manifest).decode().splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise FleetError(
            f"the manifest {manifest} cannot be read ({error}); give a text file, one log a line"
        ) from error
    wanted = [line for line in lines if line and not line.startswith("#")]
    return [line if _REMOTE in line else os.fspath(manifest.parent / line) for line in wanted]


def _checked(path: Path) -> Path:
    if not path.exists():
        raise FleetError(f"there is no log {path}; check the path")
    return path


def _fetched(url: str, cache: Path) -> Path:
    """A copy of what is at a URL; one that exists already is not fetched again."""
    path = cache / f"{hashlib.sha256(url.encode()).hexdigest()[:16]}_{url.rpartition('/')[2] or 'log'}"
    if path.exists():
        return path
    if importlib.util.find_spec("fsspec") is None:
        raise FleetError(f"{url} needs fsspec: pip install 'descriptellation-slam[fleet]'")
    import fsspec

    cache.mkdir(parents=True, exist_ok=True)
    partial = partial_path(path)
    try:
        with fsspec.open(url, "rb") as source, partial.open("wb") as copy:
            shutil.copyfileobj(source, copy)
    except (OSError, ValueError, ImportError) as error:
        raise FleetError(f"{url} cannot be fetched: {error}; check the address, or fetch it yourself") from error
    os.replace(partial, path)
    return path
