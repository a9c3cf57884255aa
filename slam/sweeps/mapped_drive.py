"""A drive that is degraded, mapped and evaluated: what all benchmarks of whole drives have in common."""

import resource
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from logs.errors import LogError
from slam.common.config import Config
from slam.common.errors import SlamError
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.evaluation.report.figures import value_at
from slam.replay import replay
from slam.simulation.faults.faulty_log import write_faulty
from slam.simulation.faults.registry import parse_faults


@dataclass(frozen=True, slots=True)
class DriveTask:
    """A log, the ``faults`` that it gets first, joined by commas, with a ``seed``, and how it is mapped.

    ``variant``: what people call the configuration, "" where there is only one.
    """

    log: Path
    config: Config
    faults: str = ""
    seed: int = 0
    variant: str = ""
    topics: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """For people."""
        return ", ".join(each for each in (self.variant, self.faults, f"seed {self.seed}") if each)


@dataclass(frozen=True, slots=True)
class MappedDrive:
    """``evaluation``: the JSON of 'dslam evaluate'; or, as ``error``, why there is none.

    ``reported``: how the replay ended, its notes and its warnings. ``log_s``: duration of the log; ``replay_s``: time
    of the replay; ``cpu_s``: time of the processor for everything; ``peak_memory_bytes``: most memory of the process.
    """

    evaluation: Mapping[str, Any] = field(default_factory=dict)
    reported: tuple[str, ...] = ()
    log_s: float = 0.0
    replay_s: float = 0.0
    cpu_s: float = 0.0
    peak_memory_bytes: int = 0
    error: str = ""

    def figure(self, key: str) -> float | None:
        """A number of the evaluation by its dotted key; None where it is undefined."""
        value = value_at(self.evaluation, key)
        return value if isinstance(value, int | float) else None


def map_drive(task: DriveTask) -> MappedDrive:
    """Degrade, map and evaluate; raises nothing, for one drive must not stop the others."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            return _map(task, Path(folder))
    except (LogError, SlamError, OSError) as error:
        return MappedDrive(error=str(error))
    except Exception as error:
        return MappedDrive(error=f"this should not happen: {type(error).__name__}: {error}")


def _map(task: DriveTask, folder: Path) -> MappedDrive:
    source, mapped, began_s = task.log, folder / "map.mcap", time.process_time()
    if task.faults:
        source = folder / "faulty.mcap"
        write_faulty(task.log, source, parse_faults([task.faults]), seed=task.seed, topics=dict(task.topics))
    started = time.perf_counter()
    summary = replay(source, mapped, task.config, topics=dict(task.topics))
    replay_s, peak = time.perf_counter() - started, _peak_memory_bytes()
    # The replay copies the truth, so that the truth of a scaled log is the scaled one.
    records = read_records(mapped)
    warnings = (status.message for status in records.statuses if status.level != "info")
    reported = tuple(dict.fromkeys([summary.final_status, *summary.notes, *warnings]))
    evaluation, cpu_s = evaluate(records).to_json_dict(), time.process_time() - began_s
    return MappedDrive(evaluation, reported, summary.log_s, replay_s, cpu_s, peak)


def _peak_memory_bytes() -> int:
    """Most memory that this process held. Linux's rusage would count what the parent held when it was started."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024
    line = next(line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024
