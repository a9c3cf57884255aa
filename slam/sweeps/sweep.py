"""A drive mapped under many degradations, each with several seeds.

``run_sweep`` is where to begin reading.
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

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
from slam.sweeps.cells import Cell, CellFolder, CellResult, compute_cell
from slam.sweeps.degradations import is_random
from slam.sweeps.workers import Death, compute_all

_log = logging.getLogger(__name__)

_FIGURES = [figure.key for figure in HEADLINE_FIGURES]


@dataclass(frozen=True, slots=True)
class Sweep:
    """``results`` by variant, degradation and seed; ``computed`` of them are new, the others were there before.

    ``wall_s``: what this time it took.
    """

    results: Mapping[Cell, CellResult]
    computed: int
    wall_s: float

    @property
    def first(self) -> Cell:
        """Any cell; all have the same drive."""
        return next(iter(self.results))

    @property
    def failures(self) -> list[str]:
        """One line for each cell that failed."""
        return [f"{cell.name}: {result.error}" for cell, result in self.results.items() if result.error]

    @property
    def evaluations(self) -> dict[str, Mapping[str, Any]]:
        """The JSON of each cell that did not fail, by the name of the cell."""
        return {cell.name: each.evaluation for cell, each in self.results.items() if each.evaluation is not None}

    def rows(self) -> dict[tuple[str, str], pd.DataFrame]:
        """The cells of each variant and degradation: ``seed``, ``file``, ``error``, ``reported``,
        ``real_time_factor``, and the headline figures by their keys, NaN where they are undefined.
        """
        table = pd.DataFrame(
            {
                "variant": cell.variant,
                "degradation": cell.degradation,
                "seed": cell.seed,
                "file": cell.file_name,
                "error": result.error,
                "reported": result.reported,
                "real_time_factor": (result.times or {}).get("real_time_factor", math.nan),
            }
            | {figure.key: figure.of(result.evaluation or {}) for figure in HEADLINE_FIGURES}
            for cell, result in self.results.items()
        )
        table[_FIGURES] = table[_FIGURES].astype(float)
        return {(str(v), str(d)): cells for (v, d), cells in table.groupby(["variant", "degradation"], sort=False)}

    def to_json_dict(self) -> dict[str, Any]:
        """Plain dicts, lists, strings and finite numbers, which but for ``times`` depend on the input alone."""
        first, protocol = self.first, Protocol()
        return {
            "input": {"log": first.log.name, "sha256": first.sha256},
            "version": first.version,
            "configuration": json.loads(first.config.model_dump_json()),
            "changes": changes(Config(), first.config.model_dump_json()),
            "variants": {cell.variant: changes(Config(), cell.config.model_dump_json()) for cell in self.results},
            "degradations": [_describe(*names, cells) for names, cells in self.rows().items()],
            "protocol": {**plain(protocol), "rules": protocol.describe()},
            "times": {
                "wall_s": self.wall_s,
                "cpu_s": sum((result.times or {}).get("cpu_s", 0.0) for result in self.results.values()),
                "computed": self.computed,
                "reused": len(self.results) - self.computed,
                "cells": {cell.file_name: dict(result.times or {}) for cell, result in self.results.items()},
            },
        }


def spread_over(cells: pd.DataFrame, column: str) -> Spread:
    """Mean and spread of a column over the cells that did not fail."""
    return Spread.over(plain(cells.loc[cells["error"] == "", column].tolist()))


def run_sweep(
    source: Path,
    folder: Path,
    degradations: Sequence[str],
    config: Config,
    *,
    seeds: int,
    jobs: int,
    topics: Mapping[str, str] | None = None,
    variants: Mapping[str, Config] | None = None,
    on_progress: Callable[[float], None] | None = None,
    compute: Callable[..., CellResult] = compute_cell,
) -> Sweep:
    """Degrade, map and evaluate a drive again and again.

    A cell that ``folder`` holds already, of the same input, degradation, seed, configuration, version and protocol, is
    not computed again; one that failed is. A degradation without random numbers has one cell, not ``seeds`` of them.

    Args:
        source: a log that can be mapped, with the truth.
        folder: keeps the cells; made if it is not there.
        degradations: what to do to the log, by their names, no two alike.
        config: of the estimator, where there are no variants.
        seeds: 0, 1, ... of the degradations.
        jobs: processes at a time.
        topics: kind -> topic, where the log leaves a choice.
        variants: configurations by name, to be compared over the same degraded drives.
        on_progress: called with the fraction of the cells done, in [0, 1].
        compute: a function of a module that computes a cell, as :func:`compute_cell` does.

    Raises:
        LogError: the input cannot be read or the folder cannot be written.
        EvaluationError: the input is no drive with a truth, or another sweep is at the folder.
    """
    started = time.perf_counter()
    _refuse_without_truth(source, topics)
    sha256, of_topics = file_sha256(source), tuple(sorted((topics or {}).items()))
    cells = [
        Cell(source, sha256, each, version("descriptellation-slam"), degradation, seed, of_topics, variant)
        for variant, each in (variants or {"": config}).items()
        for degradation in degradations
        for seed in range(seeds if is_random(degradation) else 1)
    ]
    with CellFolder(folder).opened() as kept:
        results = {cell: result for cell in cells if (result := kept.finished(cell)) is not None}
        # Seed by seed, so that a sweep that is stopped tells something of each degradation.
        new = sorted((cell for cell in cells if cell not in results), key=lambda cell: cell.seed)
        with closing(compute_all(partial(compute, scratch=kept.scratch), new, jobs=jobs)) as outcomes:
            for cell, outcome in outcomes:
                result = _after_death(outcome) if isinstance(outcome, Death) else outcome
                kept.keep(cell, result)
                results[cell] = result
                _log.info("%s: %s", cell.name, result.error or "done")
                if on_progress is not None:
                    on_progress(len(results) / len(cells))
    return Sweep({cell: results[cell] for cell in cells}, len(new), time.perf_counter() - started)


def _refuse_without_truth(source: Path, topics: Mapping[str, str] | None) -> None:
    with LogReader(source) as reader:
        there = reader.topics()
    if any(info.topic.startswith(OUTPUT_PREFIX) for info in there):
        raise EvaluationError(f"{source} is a map already; give the drive that it was made from")
    if not select_topics(there, topics).topics_of(RecordKind.GROUND_TRUTH):
        raise EvaluationError(f"{source} has no ground truth to compare with; record /ground_truth or name its topic")


def _after_death(death: Death) -> CellResult:
    why = f"the process ended with code {death.exit_code}, perhaps for lack of memory; try fewer jobs"
    return CellResult(None, why)


def _describe(variant: str, name: str, cells: pd.DataFrame) -> dict[str, Any]:
    return {
        "name": name,
        "variant": variant,
        "figures": {key: asdict(spread_over(cells, key)) for key in _FIGURES},
        "cells": [
            {**cell, "figures": plain(figures)}
            for cell, figures in zip(
                cells[["seed", "file", "error", "reported"]].to_dict("records"),
                cells[_FIGURES].to_dict("records"),
                strict=True,
            )
        ],
    }
