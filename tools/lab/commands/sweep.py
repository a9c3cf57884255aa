"""dslam sweep: one drive with many faults and settings."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from tools.arguments import (
    ConfigFile,
    InputLog,
    Jobs,
    Json,
    Settings,
    TableFiles,
    Topics,
    check_outputs,
    parse_topics,
)
from tools.evaluation.requirements import Require, finish
from tools.lab.tables import Markdown, ResultFolder, report, rows_of


def sweep(
    log: InputLog,
    folder: ResultFolder,
    degrade: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FAULT=VALUE,...",
            help="Faults of 'dslam degrade --list-faults', joined by commas; 'every fault': each alone. Repeatable; by "
            "default five degradations.",
        ),
    ] = None,
    variant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE;...",
            help="Settings to compare over the same drives, joined by semicolons. Repeatable.",
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of each degradation.")] = 3,
    jobs: Jobs = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    tables: TableFiles = None,
    markdown: Markdown = False,
    as_json: Json = False,
    require: Require = None,
) -> None:
    """Degrade, map and evaluate a drive again and again, for each --degrade, --variant and seed.

    After an interruption, the same command continues.

    Example: dslam sweep drive.mcap -o out/sweep --degrade dropout=0.5 --degrade dropout=0.8,max_range=30

    Example: dslam sweep drive.mcap -o out/descriptors --variant loop_closure.descriptor=gosmatch_vertex
    --variant loop_closure.descriptor=descriptellation_lr
    """
    check_outputs(tables or (), [log])
    from slam.common.config import load_config
    from slam.evaluation.comparison import RULE
    from slam.evaluation.report.table_files import check_endings, write_table
    from slam.sweeps.sweep import DEFAULT_DEGRADATIONS, plan_sweep, run_sweep
    from tools import console

    check_endings(tables or ())
    variants = {
        text: load_config(config_file, [*(settings or ()), *filter(None, text.split(";"))]) for text in variant or [""]
    }
    tasks = plan_sweep(
        log, ["", *(degrade or DEFAULT_DEGRADATIONS)], variants, seeds=seeds, topics=parse_topics(topics)
    )
    with console.progress_bar("sweeping", "sweeping") as progress:
        swept = run_sweep(tasks, folder, jobs=jobs or os.cpu_count() or 1, on_progress=progress)
    comparison = swept.compare()
    for path in tables or ():
        write_table(path, comparison.to_table().T, RULE)
    first = {task.name: result for task, result in swept.results.items() if task.seed == 0}
    report(
        rows_of(comparison).to_dict("records"),
        RULE,
        f"{swept.computed} drives mapped, {len(tasks) - swept.computed} mapped before",
        *(f"{name}: {'; '.join(result.reported) or result.error}" for name, result in first.items()),
        markdown=markdown,
        json=swept.to_json_dict() if as_json else None,
    )
    runs = {task.name: result.evaluation for task, result in swept.results.items() if not result.error}
    finish(runs, require, quiet=as_json, failures=swept.failures)
