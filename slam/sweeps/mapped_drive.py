"""A drive mapped in a process of its own, and evaluated: what all benchmarks of whole drives have in common."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from logs.errors import LogError
from slam.common.config import Config
from slam.common.errors import SlamError
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords, read_records
from slam.replay import ReplaySummary, replay
from slam.simulation.faults.faulty_log import write_faulty
from slam.simulation.faults.registry import parse_faults
from slam.sweeps.workers import Death, compute_all


@dataclass(frozen=True, slots=True)
class DriveTask:
    """A log, the faults that it gets first with a seed, and how it is mapped.

    ``scratch``: folder in which a process that is killed may leave logs behind. ``online``: calibrate the robot during
    the drive; ``online_from``: share of the way from which online poses are evaluated.
    """

    name: str
    log: Path
    config: Config
    scratch: Path
    topics: Mapping[str, str] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    seed: int = 0
    online: bool = False
    online_from: float = 0.0


@dataclass(frozen=True, slots=True)
class MappedDrive:
    """What the replay reported and, as ``evaluation``, the JSON of 'dslam evaluate'; or why there is none.

    ``warnings``: messages of the log at the level of a warning or an error, each once. ``peak_memory_bytes``: most
    memory of the process until the end of the replay; ``seconds`` of the replay, ``cpu_s`` of the processor for all.
    """

    name: str
    summary: ReplaySummary | None = None
    evaluation: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    peak_memory_bytes: int = 0
    seconds: float = 0.0
    cpu_s: float = 0.0
    error: str = ""

    @property
    def reported(self) -> str:
        """How the replay ended, its notes and its warnings; or the error."""
        if self.summary is None:
            return f"error: {self.error}"
        return "; ".join(dict.fromkeys([self.summary.final_status, *self.summary.notes, *self.warnings]))

    def figure(self, key: str) -> float | None:
        """A number of the evaluation by its dotted key; None where it is undefined."""
        value: Any = self.evaluation
        for part in key.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        return value if isinstance(value, int | float) else None


def map_drives(tasks: Sequence[DriveTask], *, jobs: int = 1) -> Iterator[MappedDrive]:
    """Each drive, as they finish, in a process of its own; one that fails or dies does not end the others."""
    for task, outcome in compute_all(map_drive, tasks, jobs=jobs, fresh=True):
        if isinstance(outcome, Death):
            error = f"the process ended without a result (exit code {outcome.exit_code}); check the memory"
            yield MappedDrive(task.name, error=error)
        else:
            yield outcome


def map_drive(task: DriveTask) -> MappedDrive:
    """Degrade, map and evaluate; raises nothing."""
    try:
        with tempfile.TemporaryDirectory(dir=task.scratch) as folder:
            return _map(task, Path(folder))
    except (LogError, SlamError, OSError) as error:
        return MappedDrive(task.name, error=str(error))
    except Exception as error:
        return MappedDrive(task.name, error=f"this should not happen: {type(error).__name__}: {error}")


def _map(task: DriveTask, folder: Path) -> MappedDrive:
    source, mapped, began_s = task.log, folder / "map.mcap", time.process_time()
    if task.faults:
        source = folder / "faulty.mcap"
        write_faulty(task.log, source, parse_faults(task.faults), seed=task.seed, topics=task.topics)
    started = time.perf_counter()
    summary = replay(source, mapped, task.config, topics=task.topics, online=task.online)
    seconds, peak = time.perf_counter() - started, _peak_memory_bytes()
    # The replay copies the truth, so that the truth of a scaled log is the scaled one.
    records = _with_online_from(read_records(mapped), task.online_from)
    warnings = dict.fromkeys(status.message for status in records.statuses if status.level != "info")
    return MappedDrive(
        task.name,
        summary,
        evaluate(records).to_json_dict(),
        tuple(warnings),
        peak,
        seconds,
        time.process_time() - began_s,
    )


def _with_online_from(records: EvaluationRecords, share: float) -> EvaluationRecords:
    """The records without the online poses before that share of the way by the odometry."""
    if share == 0.0 or not records.odometry:
        return records
    path = records.odometry_path
    travel_m = np.cumsum(np.linalg.norm(np.diff(path.positions, axis=0, prepend=path.positions[:1]), axis=1))
    first_ns = path.stamps_ns[np.searchsorted(travel_m, share * travel_m[-1])]
    return replace(records, online_poses=tuple(each for each in records.online_poses if each.stamp_ns >= first_ns))


def _peak_memory_bytes() -> int:
    """Most memory that this process held. Linux's rusage would count what the parent held when it was started."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024
    line = next(line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024
