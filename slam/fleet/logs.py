"""The logs of a fleet: files, and URLs that are fetched once."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from logs.storage.regular_file import read_regular
from logs.writer import partial_path
from slam.common.errors import FleetError

_REMOTE = "://"


@dataclass(frozen=True, slots=True)
class FleetLog:
    """A log by the name that people know, and where it is."""

    name: str
    path: Path


def find_logs(sources: Sequence[str], manifest: Path | None, cache: Path) -> list[FleetLog]:
    """Logs by path or URL, those of a manifest after the others; each once, in that order.

    Args:
        sources: as they are written; names of files are relative to the working folder.
        manifest: a text file with one a line, relative to its own folder; lines that begin with # are left out.
        cache: folder for what is fetched.

    Raises:
        FleetError: no log at all, a manifest that cannot be read, a log that is not there, or a URL without fsspec.
    """
    named = dict.fromkeys([*sources, *(_listed(manifest) if manifest is not None else ())])
    if not named:
        raise FleetError("no log was given; name one at least")
    return [FleetLog(name, _fetched(name, cache) if _REMOTE in name else _checked(Path(name))) for name in named]


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
    """A copy of what is at a URL; one that is there already is not fetched again."""
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
