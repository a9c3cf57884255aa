"""dslam sweep: one drive with many faults and settings."""

import os
from typing import Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Jobs, Json, Settings, Topics, parse_topics
from tools.evaluation.requirements import Require, finish
from tools.lab.tables import Markdown, ResultFolder, report, rows_of

EVERY_PART = "every part"
COPIES = "position_noise=0.001,odometry_translation_noise=0.001"
"""Noise far below that of any sensor, so that copies of a drive differ only by chance."""


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
            metavar="KEY=VALUE;...", help="Settings to compare over the same drives, joined by semicolons. Repeatable."
        ),
    ] = None,
    part: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Compare with the method without this part, by default over copies of the drive with a little noise, "
            "which separate effects from chance; 'every part': each alone. Repeatable.",
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of each degradation.")] = 3,
    jobs: Jobs = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    markdown: Markdown = False,
    as_json: Json = False,
    require: Require = None,
) -> None:
    """Degrade, map and evaluate a drive for each --degrade, --variant or --part, and for each seed.

    After an interruption, the same command continues.

    Example: dslam sweep drive.mcap -o out/sweep --degrade dropout=0.5 --degrade dropout=0.8,max_range=30

    Example: dslam sweep drive.mcap -o out/descriptors --variant loop_closure.descriptor=gosmatch_vertex
    --variant loop_closure.descriptor=descriptellation_lr

    Example: dslam sweep drive.mcap -o out/ablation --part calibration --part labels
    """
    from slam.common.config import load_config
    from slam.sweeps.comparison import note_of
    from slam.sweeps.sweep import DEFAULT_DEGRADATIONS, plan_sweep, run_sweep
    from tools import console
    from tools.lab.drives.parts import PARTS, map_without

    parts = part or []
    for name in parts:
        if name not in (*PARTS, EVERY_PART):
            raise typer.BadParameter(f"there is no {name!r}; there are: {'; '.join(PARTS)}.", param_hint="--part")
    if EVERY_PART in parts:
        parts = list(PARTS)
    changed = {text: text.split(";") for text in variant or ()} | {name: PARTS[name].settings for name in parts}
    if not variant:
        changed = {"": (), **changed}
    variants = {name: load_config(config_file, [*(settings or ()), *more]) for name, more in changed.items()}
    wanted = degrade or [COPIES] if parts else ["", *(degrade or DEFAULT_DEGRADATIONS)]
    tasks = plan_sweep(log, wanted, variants, seeds=seeds, topics=parse_topics(topics))
    with console.progress_bar("sweeping") as progress:
        swept = run_sweep(tasks, folder, jobs=jobs or os.cpu_count() or 1, on_progress=progress, compute=map_without)
    comparison = swept.compare()
    first = {task.name: result for task, result in swept.results.items() if task.seed == 0}
    report(
        rows_of(comparison),
        note_of(comparison),
        f"{swept.computed} drives mapped, {len(tasks) - swept.computed} mapped before",
        *(f"{name}: {'; '.join(result.reported) or result.error}" for name, result in first.items()),
        markdown=markdown,
        json=swept.to_json_dict() if as_json else None,
    )
    runs = {task.name: result.evaluation for task, result in swept.results.items() if not result.error}
    finish(runs, require, quiet=as_json, failures=swept.failures)
