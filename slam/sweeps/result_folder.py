"""The folder that keeps the results of a sweep, so that one that was interrupted continues."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from logs.digest import content_key, file_sha256
from logs.errors import UnwritableLogError
from logs.storage.placement import write_text
from slam.sweeps.mapped_drive import DriveTask, MappedDrive


class ResultFolder:
    """A JSON file for each drive, named by a key of all that the result depends on."""

    def __init__(self, path: Path, log: Path) -> None:
        """Make the folder if need be.

        Raises:
            UnwritableLogError: it cannot be made.
        """
        self._cells = path / "cells"
        self._input_sha256 = file_sha256(log)
        try:
            self._cells.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UnwritableLogError(f"cannot write into {self._cells}: {error.strerror}") from error

    def path_of(self, task: DriveTask) -> Path:
        """The file of a drive: for people the faults and the seed, for the program the key."""
        made_from = (self._input_sha256, task.topics, task.faults, task.seed, task.variant)
        key = content_key(*made_from, task.config.model_dump_json(), version("descriptellation-slam"))
        faults = re.sub(r"[^\w.,=+-]", "_", task.faults or "undegraded")[:80]
        return self._cells / f"{faults}_seed{task.seed}_{key}.json"

    def finished(self, task: DriveTask) -> MappedDrive | None:
        """The result of a drive that was mapped before; one that failed or cannot be read is to be tried again."""
        try:
            result = TypeAdapter(MappedDrive).validate_json(self.path_of(task).read_bytes())
        except (OSError, ValidationError):
            return None
        return None if result.error else result

    def keep(self, task: DriveTask, result: MappedDrive) -> None:
        """Write the result, whole or not at all.

        Raises:
            UnwritableLogError: it cannot be written.
        """
        write_text(self.path_of(task), json.dumps(asdict(result), indent=1, allow_nan=False) + "\n")
