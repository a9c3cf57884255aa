"""One cell of a sweep: a drive degraded with a seed, mapped and evaluated; and the folder that keeps those finished."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from logs.errors import UnwritableLogError
from logs.storage.placement import write_text
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.sweeps.degradations import cases_of
from slam.sweeps.mapped_drive import DriveTask, map_drive


@dataclass(frozen=True, slots=True)
class Cell:
    """One degradation of the drive in ``log`` with one seed, how it is mapped, and by which ``version`` of the program.

    ``variant``: name of the configuration, "" if there is only one.
    """

    log: Path
    sha256: str
    config: Config
    version: str
    degradation: str
    seed: int
    topics: tuple[tuple[str, str], ...] = ()
    variant: str = ""

    @property
    def name(self) -> str:
        """For people."""
        return ", ".join(each for each in (self.variant, self.degradation, f"seed {self.seed}") if each)

    @property
    def key(self) -> str:
        """SHA-256 of all that the result depends on."""
        protocol = Protocol()
        content = {
            "input_sha256": self.sha256,
            "topics": sorted(self.topics),
            "degradation": self.degradation,
            "seed": self.seed,
            "variant": self.variant,
            "configuration": self.config.model_dump(mode="json"),
            "version": self.version,
            "protocol": [asdict(protocol), protocol.describe()],
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    @property
    def file_name(self) -> str:
        """For people the degradation and the seed, for the program the key."""
        safe_name = re.sub(r"[^\w.,=+-]", "_", self.degradation)[:80]
        return f"{safe_name}_seed{self.seed}_{self.key[:16]}.json"


@dataclass(frozen=True, slots=True)
class CellResult:
    """The ``evaluation`` of a cell as JSON, or why there is none; ``reported``: what the replay told.

    ``times``: seconds of the replay (``replay_s``), seconds of the processor for everything (``cpu_s``), which do not
    depend on how busy the machine is, and the ``real_time_factor``.
    """

    evaluation: Mapping[str, Any] | None
    error: str = ""
    times: Mapping[str, float] | None = None
    reported: str = ""


def compute_cell(cell: Cell, *, scratch: Path) -> CellResult:
    """Degrade, map and evaluate; raises nothing, for one cell must not stop the others.

    Args:
        cell: what to do.
        scratch: folder in which a process that is killed may leave logs behind.
    """
    faults = tuple(case.name for case in cases_of(cell.degradation))
    run = map_drive(DriveTask(cell.name, cell.log, cell.config, scratch, dict(cell.topics), faults, cell.seed))
    times = {"replay_s": run.seconds, "cpu_s": run.cpu_s}
    if run.summary is not None and run.seconds > 0.0:
        times["real_time_factor"] = run.summary.log_s / run.seconds
    return CellResult(run.evaluation or None, run.error, times, run.reported)


class CellFolder:
    """Results of cells, one JSON file each, under their keys."""

    def __init__(self, path: Path) -> None:
        self._cells = path / "cells"
        self.scratch = self._cells / "unfinished"

    @contextmanager
    def opened(self) -> Iterator[CellFolder]:
        """The folder, created if necessary and locked for this process; unfinished files of a killed sweep are removed.

        Raises:
            EvaluationError: another sweep is at it.
            UnwritableLogError: it cannot be made.
        """
        try:
            self._cells.mkdir(parents=True, exist_ok=True)
            lock = os.open(self._cells, os.O_RDONLY)  # the system takes it back from a process that is killed
        except OSError as error:
            raise UnwritableLogError(
                f"cannot write into {self._cells}: {error.strerror}; give another folder"
            ) from error
        try:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise EvaluationError(
                    f"another sweep is writing into {self._cells.parent}; give another folder"
                ) from error
            self._clean_up()
            self.scratch.mkdir(exist_ok=True)
            try:
                yield self
            finally:
                self._clean_up()
        finally:
            os.close(lock)

    def finished(self, cell: Cell) -> CellResult | None:
        """The result of a cell that was computed before; one that failed or cannot be read is to be tried again."""
        try:
            stored = json.loads((self._cells / cell.file_name).read_text(encoding="utf-8"))
            result = TypeAdapter(CellResult).validate_python(stored)
        except (OSError, ValueError, TypeError, KeyError, RecursionError, ValidationError):
            return None
        return result if stored["key"] == cell.key and result.evaluation is not None else None

    def keep(self, cell: Cell, result: CellResult) -> None:
        """Write the result, whole or not at all.

        Raises:
            UnwritableLogError: it cannot be written.
        """
        stored = {"key": cell.key, "degradation": cell.degradation, "seed": cell.seed, **asdict(result)}
        write_text(self._cells / cell.file_name, json.dumps(stored, indent=1, allow_nan=False) + "\n")

    def _clean_up(self) -> None:
        shutil.rmtree(self.scratch, ignore_errors=True)
        for part in self._cells.glob("*.json.part"):
            part.unlink(missing_ok=True)
