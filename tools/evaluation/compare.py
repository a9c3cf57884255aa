"""dslam compare: runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, Topics, parse_topics
from tools.evaluation.evaluated_log import (
    Calib,
    MapRun,
    Protocols,
    Reference,
    Times,
    evaluate_log,
    parse_thresholds,
)
from tools.evaluation.requirements import Require, finish


def compare(
    logs: Annotated[list[Path], typer.Argument(metavar="OUT.mcap...", help="Logs that 'dslam replay' wrote.")],
    reference: Reference = None,
    times: Times = None,
    calib: Calib = None,
    topics: Topics = None,
    as_json: Json = False,
    map_run: MapRun = None,
    protocol: Protocols = None,
    require: Require = None,
) -> None:
    """Evaluate several maps, and print them side by side.

    Runs of one version and configuration count as repetitions; differences
    larger than their spread are marked.

    Example: dslam compare a1.mcap a2.mcap a3.mcap b1.mcap b2.mcap b3.mcap
    """
    truth = (reference, times, calib, map_run, parse_topics(topics), parse_thresholds(protocol))
    if len(logs) < 2:
        raise typer.BadParameter("one log was given; give two or more, or use 'dslam evaluate'", param_hint="OUT.mcap")
    from slam.evaluation.comparison import Run, compare_runs
    from tools import console

    _refuse_copies(logs)
    runs = []
    for log in logs:
        records, evaluation = evaluate_log(log, *truth)
        runs.append(Run(str(log), evaluation.to_json_dict(), records.provenance))
    comparison = compare_runs(runs)
    if as_json:
        console.show_json(comparison.to_json_dict())
    else:
        members = [f"{label}: {', '.join(run.name for run in group)}" for label, group in comparison.groups.items()]
        rows = comparison.to_table().rename_axis("").reset_index().to_dict("records")
        console.show(console.table(rows), "", *members, comparison.note)
    finish({run.name: run.results for run in runs}, require, quiet=as_json)


def _refuse_copies(logs: Sequence[Path]) -> None:
    """The same run twice would have no spread, and everything else would seem to differ from it."""
    from logs.digest import file_sha256
    from slam.common.errors import EvaluationError

    seen: dict[str, Path] = {}
    for log in logs:
        first = seen.setdefault(file_sha256(log), log)
        if first is not log:
            raise EvaluationError(f"{first} and {log} are the same run (equal bytes); give each run once")
