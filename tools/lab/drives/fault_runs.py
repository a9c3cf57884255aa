"""One drive again and again, each time with another fault of its input: degraded, mapped and evaluated."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from logs.errors import LogError
from slam.common.config import Config
from slam.common.errors import EvaluationError, SlamError
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords, read_records
from slam.evaluation.result import Evaluation
from slam.replay import ReplaySummary, replay
from slam.simulation.faults.fault import FaultCase
from slam.simulation.faults.faulty_log import write_faulty
from slam.simulation.faults.registry import parse_fault
from slam.sweeps.workers import Death, compute_all

CLEAN = "none"


@dataclass(frozen=True, slots=True)
class FaultRun:
    """A drive with one fault. Where it could not be mapped, ``error`` says why, and the measures are None.

    ``fault``: as :func:`slam.simulation.faults.registry.parse_fault` reads it, or "none". ``odometry_ate_m``: of the
    faulted odometry. ``false_closures_in_graph``: those among the factors of the final graph.
    ``landmarks``: confirmed ones. ``seconds``: of the replay. ``notes``: what the survey of the log found.
    ``warnings``: what the log said at the level of a warning
    or an error, each message once, and ``counters`` at the end.
    """

    fault: str
    ate_m: float | None = None
    odometry_ate_m: float | None = None
    closures_accepted: int | None = None
    precision: float | None = None
    false_closures_in_graph: int | None = None
    landmarks: int | None = None
    seconds: float | None = None
    final_status: str = ""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    counters: Mapping[str, int] = field(default_factory=dict)
    error: str = ""


@dataclass(frozen=True, slots=True)
class FaultTask:
    """A drive, a fault by its name, and the folder in which a process that is killed may leave logs behind."""

    log: Path
    config: Config
    topics: Mapping[str, str]
    fault: str
    seed: int
    scratch: Path


def benchmark_faults(
    log: Path,
    cases: Sequence[FaultCase],
    config: Config,
    *,
    seed: int = 0,
    jobs: int = 1,
    topics: Mapping[str, str] | None = None,
) -> Iterator[FaultRun]:
    """The drive as it is, then with each of the faults, as they finish, each in a process of its own.

    The truth is that of the log; a fault that scales all lengths scales it too.

    Args:
        log: a drive with true poses.
        cases: the faults.
        config: by which all are mapped.
        seed: of what is random in the faults.
        jobs: processes at a time.
        topics: kind -> topic, where the log leaves a choice.

    Raises:
        LogError: the log cannot be read.
        EvaluationError: it holds no true poses.
    """
    if not read_records(log, topics=topics).true_poses:
        raise EvaluationError(
            f"{log} holds no true poses (/ground_truth), so no error can be measured; give one that does"
        )
    with tempfile.TemporaryDirectory() as folder:
        names = [CLEAN, *(case.name for case in cases)]
        tasks = [FaultTask(log, config, topics or {}, name, seed, Path(folder)) for name in names]
        for task, outcome in compute_all(run_fault, tasks, jobs=jobs, fresh=True):
            if isinstance(outcome, Death):
                yield FaultRun(task.fault, error=f"the process ended without a result (exit code {outcome.exit_code})")
            else:
                yield outcome


def run_fault(task: FaultTask) -> FaultRun:
    """Degrade, map and evaluate; raises nothing, for one fault must not stop the others."""
    try:
        with tempfile.TemporaryDirectory(dir=task.scratch) as folder:
            return _run(task, Path(folder))
    except (LogError, SlamError, OSError) as error:
        return FaultRun(task.fault, error=str(error))
    except Exception as error:
        return FaultRun(task.fault, error=f"this should not happen: {type(error).__name__}: {error}")


def _run(task: FaultTask, folder: Path) -> FaultRun:
    source, mapped = task.log, folder / "map.mcap"
    if task.fault != CLEAN:
        source = folder / "faulty.mcap"
        write_faulty(task.log, source, [parse_fault(task.fault)], seed=task.seed, topics=task.topics)
    started = time.perf_counter()
    summary = replay(source, mapped, task.config, topics=task.topics)
    seconds = time.perf_counter() - started
    # The replay copies the truth, so that of a scaled log is the scaled one.
    records = read_records(mapped)
    return _measured(task.fault, summary, records, evaluate(records), seconds)


def _measured(
    fault: str, summary: ReplaySummary, records: EvaluationRecords, evaluation: Evaluation, seconds: float
) -> FaultRun:
    closures = evaluation.closures
    warnings = (status.message for status in records.statuses if status.level != "info")
    return FaultRun(
        fault=fault,
        ate_m=evaluation.estimate.absolute.rmse_m if evaluation.estimate else None,
        odometry_ate_m=evaluation.odometry.absolute.rmse_m if evaluation.odometry else None,
        closures_accepted=closures.accepted_count if closures else 0,
        precision=closures.precision if closures else None,
        false_closures_in_graph=_false_factors(evaluation),
        landmarks=summary.counters.get("landmarks_confirmed", 0),
        seconds=seconds,
        final_status=summary.final_status,
        notes=summary.notes,
        warnings=tuple(dict.fromkeys(warnings)),
        counters=summary.counters,
    )


def _false_factors(evaluation: Evaluation) -> int | None:
    """Closures that are factors of the final graph and that the truth refutes; None without a truth to ask."""
    closures = evaluation.closures
    if closures is None:
        return 0
    if not closures.has_truth:
        return None
    judged = closures.judged
    inserted = np.array([c.accepted and c.inserted for c in judged.candidates], dtype=np.bool_)
    return int(np.count_nonzero(inserted & judged.decided & ~judged.true))
