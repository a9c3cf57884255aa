"""Many drives mapped from one log: with faults, seeds and settings.

``run_sweep`` is where to begin reading.
"""

import json
import logging
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import TypeAdapter, ValidationError

from logs.digest import content_key, file_sha256
from logs.errors import UnwritableLogError
from logs.reader import LogReader
from logs.records import frozen
from logs.selection import OUTPUT_PREFIX, select_topics
from logs.storage.placement import write_text
from logs.topics import RecordKind
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.simulation.faults.registry import FAULTS, parse_faults
from slam.sweeps.comparison import compare, note_of
from slam.sweeps.mapped_drive import DriveTask, MappedDrive, map_drive
from slam.sweeps.workers import DIED, compute_all

_log = logging.getLogger(__name__)

DEFAULT_DEGRADATIONS = (
    "dropout=0.7",
    "position_noise=1",
    "label_confusion=0.5",
    "false_positives=10",
    "odometry_yaw_noise=0.005",
)
EVERY_FAULT = "every fault"


@frozen
class Sweep:
    """``results`` by task; ``computed`` of them are new, the others were there before."""

    results: Mapping[DriveTask, MappedDrive]
    computed: int

    @property
    def failures(self) -> list[str]:
        """One line for each drive that failed."""
        return [f"{task.name}: {result.error}" for task, result in self.results.items() if result.error]

    @property
    def labels(self) -> list[str]:
        """The group of each drive: those with the same faults and settings are repetitions."""
        made = [{"faults": task.faults or "none", "variant": task.variant} for task in self.results]
        differing = [key for key in made[0] if len({each[key] for each in made}) > 1] or list(made[0])
        return [", ".join(f"{key}={each[key]}" for key in differing) for each in made]

    def compare(self) -> pd.DataFrame:
        """The spread of the figures in each group, as :func:`slam.sweeps.comparison.compare` returns it."""
        return compare(self.labels, list(self.results.values()))

    def to_json_dict(self) -> dict[str, Any]:
        """The comparison, and of each drive how its replay ended; all but ``times`` depends on the input alone."""
        spreads, results = self.compare(), self.results.items()
        runs = [
            {"log": task.name, "group": label, "error": result.error, "reported": result.reported}
            for label, (task, result) in zip(self.labels, results, strict=True)
        ]
        return {
            "runs": runs,
            "groups": {label: spreads.loc[label].to_dict("index") for label in dict.fromkeys(self.labels)},
            "note": note_of(spreads),
            "computed": self.computed,
            "times": {task.name: {"replay_s": each.replay_s, "cpu_s": each.cpu_s} for task, each in results},
        }


def plan_sweep(
    log: Path,
    degradations: Sequence[str],
    variants: Mapping[str, Config],
    *,
    seeds: int,
    topics: Mapping[str, str] | None = None,
) -> list[DriveTask]:
    """A drive for each variant, degradation and seed; where nothing is random, for one seed only.

    Args:
        log: a drive with truth.
        degradations: faults joined by commas, applied in this order; "" for none.
        variants: configurations by name.
        seeds: how many, from 0 on.
        topics: kind -> topic, where the log leaves a choice.

    Raises:
        LogError: the log cannot be read.
        EvaluationError: it is no drive with a truth.
        ConfigurationError: a fault that does not exist, or a value that is not allowed.
    """
    with LogReader(log) as reader:
        there = reader.topics()
    if any(info.topic.startswith(OUTPUT_PREFIX) for info in there):
        raise EvaluationError(f"{log} is a map already; give the drive that it was made from")
    if not select_topics(there, topics).topics_of(RecordKind.GROUND_TRUTH):
        raise EvaluationError(f"{log} has no ground truth to compare with; record /ground_truth or name its topic")
    return [
        DriveTask(log, config, faults, seed, variant, tuple(sorted((topics or {}).items())))
        for variant, config in variants.items()
        for faults, is_random in _named(degradations).items()
        for seed in range(seeds if is_random else 1)
    ]


def run_sweep(
    tasks: Sequence[DriveTask],
    folder: Path,
    *,
    jobs: int,
    on_progress: Callable[[float], None] = lambda fraction: None,
    compute: Callable[[DriveTask], MappedDrive] = map_drive,
) -> Sweep:
    """Degrade, map and evaluate one log again and again.

    A result that ``folder`` holds already, of the same input, faults, seed, configuration and version, is not
    computed again; a failure is.

    Args:
        tasks: of one log.
        folder: keeps the results; made if it is not there.
        jobs: processes at a time.
        on_progress: called with the fraction of the drives done, in [0, 1].
        compute: a function of a module that maps a drive, as :func:`map_drive` does.

    Raises:
        LogError: the input cannot be read or the folder cannot be written.
    """
    cells, input_sha256 = folder / "cells", file_sha256(tasks[0].log)
    try:
        cells.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnwritableLogError(f"cannot write into {cells}: {error.strerror}") from error
    paths = {task: cells / result_name(task, input_sha256) for task in tasks}
    results = {task: result for task, path in paths.items() if (result := _finished(path)) is not None}
    # Seed by seed, so that a sweep that is stopped has some results of each degradation.
    new = sorted((task for task in tasks if task not in results), key=lambda task: task.seed)
    with closing(compute_all(compute, new, jobs=jobs)) as outcomes:
        for task, outcome in outcomes:
            result = outcome or MappedDrive(error=DIED)
            write_text(paths[task], json.dumps(asdict(result), indent=1, allow_nan=False) + "\n")
            results[task] = result
            _log.info("%s: %s", task.name, result.error or "done")
            on_progress(len(results) / len(tasks))
    return Sweep({task: results[task] for task in tasks}, len(new))


def _named(degradations: Sequence[str]) -> dict[str, bool]:
    """Whether each degradation is random, by its name; two that do the same have the same name."""
    found = dict[str, bool]()
    for text in degradations:
        if text == EVERY_FAULT:
            found |= {fault.name: fault.is_random for fault in FAULTS.values() if "LABEL" not in fault.values}
        else:
            faults = parse_faults([text] if text else [])
            found[",".join(fault.name for fault in faults)] = any(fault.is_random for fault in faults)
    return found


def result_name(task: DriveTask, input_sha256: str) -> str:
    """The name of the file of a result: for people the faults and the seed, for the program a key of all that it
    depends on.
    """
    made_from = (input_sha256, task.topics, task.faults, task.seed, task.variant)
    key = content_key(*made_from, task.config.model_dump_json(), version("descriptellation-slam"))
    faults = re.sub(r"[^\w.,=+-]", "_", task.faults or "undegraded")[:80]
    return f"{faults}_seed{task.seed}_{key}.json"


def _finished(path: Path) -> MappedDrive | None:
    """The result of a drive that was mapped before; one that failed or cannot be read is to be tried again."""
    try:
        result = TypeAdapter(MappedDrive).validate_json(path.read_bytes())
    except (OSError, ValidationError):
        return None
    return None if result.error else result
