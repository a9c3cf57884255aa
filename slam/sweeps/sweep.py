"""A drive mapped under many degradations, each with several seeds.

``run_sweep`` is where to begin reading.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from logs.digest import file_sha256
from logs.reader import LogReader
from logs.selection import OUTPUT_PREFIX, select_topics
from logs.topics import RecordKind
from slam.common.config import Config
from slam.common.config_tree import changes
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.metrics.statistics import Spread
from slam.evaluation.report.figures import HEADLINE_FIGURES
from slam.evaluation.result import plain
from slam.sweeps.cells import Cell, CellFolder, CellResult, CellTask, Drive, compute_cell
from slam.sweeps.degradations import Degradation
from slam.sweeps.workers import Death, compute_all

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One degradation with all its seeds; ``spreads`` are of the cells that did not fail, by the key of the figure.

    ``variant``: of the configuration, "" where there is only one.
    """

    degradation: Degradation
    results: tuple[tuple[Cell, CellResult], ...]
    variant: str = ""

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.degradation.name}: {self.variant}" if self.variant else self.degradation.name

    @property
    def failed_count(self) -> int:
        """How many of the cells failed."""
        return sum(bool(result.error) for _, result in self.results)

    @property
    def spreads(self) -> dict[str, Spread]:
        """Mean and spread over the seeds."""
        evaluations = [result.evaluation for _, result in self.results if result.evaluation is not None]
        return {figure.key: Spread.over(figure.of(each) for each in evaluations) for figure in HEADLINE_FIGURES}

    @property
    def real_time_factor(self) -> Spread:
        """How many times as fast as it was driven the drive was mapped, on this machine."""
        return Spread.over(result.times.get("real_time_factor") for _, result in self.results)


@dataclass(frozen=True, slots=True)
class Sweep:
    """``rows`` by variant, then in the order of the degradations.

    ``computed`` of the cells are new, the others were there before. ``wall_s``: what this time it took.
    """

    drive: Drive
    rows: tuple[SweepRow, ...]
    computed: int
    wall_s: float

    @property
    def results(self) -> list[tuple[Cell, CellResult]]:
        """All cells."""
        return [pair for row in self.rows for pair in row.results]

    @property
    def failures(self) -> list[str]:
        """One line for each cell that failed."""
        return [f"{cell.name}: {result.error}" for cell, result in self.results if result.error]

    @property
    def variants(self) -> list[str]:
        """Names of the configurations, in their order."""
        return list(dict.fromkeys(row.variant for row in self.rows))

    def to_json_dict(self) -> dict[str, Any]:
        """Plain dicts, lists, strings and finite numbers, which but for ``times`` depend on the input alone."""
        drive, protocol = self.drive, Protocol()
        return {
            "input": {"log": drive.path.name, "sha256": drive.sha256},
            "version": drive.version,
            "configuration": json.loads(drive.config.model_dump_json()),
            "changes": changes(Config(), drive.config.model_dump_json()),
            "variants": {
                row.variant: changes(Config(), row.results[0][0].drive.config.model_dump_json()) for row in self.rows
            },
            "degradations": [_row_dict(row) for row in self.rows],
            "protocol": {**plain(protocol), "rules": protocol.describe()},
            "times": {
                "wall_s": self.wall_s,
                "cpu_s": sum(result.times.get("cpu_s", 0.0) for _, result in self.results),
                "computed": self.computed,
                "reused": len(self.results) - self.computed,
                "cells": {cell.file_name: dict(result.times) for cell, result in self.results},
            },
        }


def run_sweep(
    source: Path,
    folder: Path,
    degradations: Sequence[Degradation],
    config: Config,
    *,
    seeds: int,
    jobs: int,
    topics: Mapping[str, str] | None = None,
    variants: Mapping[str, Config] | None = None,
    on_progress: Callable[[float], None] | None = None,
    compute: Callable[[CellTask], CellResult] = compute_cell,
) -> Sweep:
    """Degrade, map and evaluate a drive again and again.

    A cell that ``folder`` holds already, of the same input, degradation, seed, configuration, version and protocol, is
    not computed again; one that failed is. A degradation without random numbers has one cell, not ``seeds`` of them.

    Args:
        source: a log that can be mapped, with the truth.
        folder: keeps the cells; made if it is not there.
        degradations: what to do to the log, no two alike.
        config: of the estimator, where there are no variants.
        seeds: 0, 1, ... of the degradations.
        jobs: processes at a time.
        topics: kind -> topic, where the log leaves a choice.
        variants: configurations by name, to be compared over the same degraded drives.
        on_progress: called with the fraction of the cells done, in [0, 1].
        compute: a function of a module that computes a cell; results of several need a folder each.

    Raises:
        LogError: the input cannot be read or the folder cannot be written.
        EvaluationError: the input is no drive with a truth, or another sweep is at the folder.
    """
    started = time.perf_counter()
    _refuse_without_truth(source, topics)
    drive = Drive(
        path=source,
        sha256=file_sha256(source),
        config=config,
        version=version("descriptellation-slam"),
        topics=tuple(sorted((topics or {}).items())),
    )
    drives = [replace(drive, config=each, variant=name) for name, each in (variants or {"": config}).items()]
    cells = [cell for each in drives for cell in _cells(each, degradations, seeds)]
    with CellFolder(folder).opened() as kept:
        results = {cell: result for cell in cells if (result := kept.finished(cell)) is not None}
        tasks = [CellTask(cell, kept.scratch) for cell in cells if cell not in results]
        with closing(compute_all(compute, tasks, jobs=jobs)) as outcomes:
            for task, outcome in outcomes:
                result = _after_death(outcome) if isinstance(outcome, Death) else outcome
                kept.keep(task.cell, result)
                results[task.cell] = result
                _log.info("%s: %s", task.cell.name, result.error or "done")
                if on_progress is not None:
                    on_progress(len(results) / len(cells))
    rows = tuple(
        SweepRow(
            degradation,
            tuple((c, results[c]) for c in cells if (c.drive, c.degradation) == (each, degradation)),
            each.variant,
        )
        for each in drives
        for degradation in degradations
    )
    return Sweep(drive, rows, len(tasks), time.perf_counter() - started)


def _cells(drive: Drive, degradations: Sequence[Degradation], seeds: int) -> list[Cell]:
    """Seed by seed, so that a sweep that is stopped tells something of each degradation."""
    return [
        Cell(drive, degradation, seed)
        for seed in range(seeds)
        for degradation in degradations
        if seed == 0 or degradation.is_random
    ]


def _refuse_without_truth(source: Path, topics: Mapping[str, str] | None) -> None:
    with LogReader(source) as reader:
        there = reader.topics()
    if any(info.topic.startswith(OUTPUT_PREFIX) for info in there):
        raise EvaluationError(f"{source} is a map already; give the drive that it was made from")
    if not select_topics(there, topics).topics_of(RecordKind.GROUND_TRUTH):
        raise EvaluationError(f"{source} has no ground truth to compare with; record /ground_truth or name its topic")


def _after_death(death: Death) -> CellResult:
    why = f"the process ended with code {death.exit_code}, perhaps for lack of memory; try fewer jobs"
    return CellResult(None, why, {})


def _row_dict(row: SweepRow) -> dict[str, Any]:
    strength = row.degradation.strength
    return {
        "name": row.degradation.name,
        "variant": row.variant,
        "options": {case.fault.name: list(case.values) for case in row.degradation.cases},
        "strength": None if strength is None else {"option": strength[0], "value": strength[1]},
        "figures": {key: asdict(spread) for key, spread in row.spreads.items()},
        "cells": [
            {
                "seed": cell.seed,
                "file": cell.file_name,
                "error": result.error,
                "figures": {figure.key: figure.of(result.evaluation or {}) for figure in HEADLINE_FIGURES},
            }
            for cell, result in row.results
        ],
    }
