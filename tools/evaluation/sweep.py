"""dslam sweep: one drive under many degradations."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Json, Settings, Topics, check_outputs, parse_topics
from tools.evaluation.output import Findings, JsonFile, Require, Rules, report


def sweep(
    log: InputLog,
    folder: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Where results go; what is finished is kept.")
    ],
    degrade: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE,...",
            help="Options of 'dslam degrade' that belong together. Repeatable; without it five usual ones.",
        ),
    ] = None,
    variant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE;...",
            help="Settings, joined by ;, to compare with those of the others over the same drives. Repeatable.",
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of each degradation.")] = 3,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes. \\[default: one a core]", show_default=False)
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    as_json: Json = False,
    json_file: JsonFile = None,
    require: Require = None,
    rules: Rules = False,
) -> None:
    """Degrade, map and evaluate a drive again and again, for each --degrade, --variant and seed.

    If it is killed, the same command goes on where it was.

    Example: dslam sweep drive.mcap -o out/sweep --degrade dropout=0.5 --degrade dropout=0.8,max_range=30

    Example: dslam sweep drive.mcap -o out/descriptors --variant loop_closure.descriptor=ring_likelihood
    --variant loop_closure.descriptor=descriptellation_lr
    """
    chosen = parse_topics(topics)
    check_outputs([json_file], [log])

    from slam.evaluation.requirements import parse_requirement

    requirements = [parse_requirement(text) for text in require or ()]
    findings = sweep_drive(
        log,
        folder,
        degradations=degrade or (),
        variants=variant or (),
        seeds=seeds,
        jobs=jobs,
        config_file=config_file,
        settings=settings or (),
        topics=chosen,
    )
    report(findings, requirements, as_json=as_json, with_rules=rules, json_file=json_file)


def sweep_drive(
    source: Path,
    folder: Path,
    *,
    degradations: Sequence[str],
    variants: Sequence[str],
    seeds: int,
    jobs: int | None,
    config_file: Path | None,
    settings: Sequence[str],
    topics: Mapping[str, str],
) -> Findings:
    """Compute what is missing of the sweep, and leave tables and picture in its folder.

    Raises:
        LogError, SlamError: the input, a degradation, a setting or the folder cannot be used.
    """
    from slam.common.config import load_config
    from slam.evaluation.inputs.protocol import Protocol
    from slam.sweeps.degradations import parse_degradations
    from slam.sweeps.outputs import JSON_NAME, PICTURE_NAME, SHEET_NAMES, TABLE_NAME, write_outputs
    from slam.sweeps.sweep import run_sweep
    from slam.sweeps.table import NOTE, closure_table, map_table
    from tools import console

    wanted = parse_degradations(degradations)
    config = load_config(config_file, settings)
    compared = {text: load_config(config_file, [*settings, *text.split(";")]) for text in variants}
    with console.progress_bar("sweeping", "drawing") as progress:
        sweep = run_sweep(
            source,
            folder,
            wanted,
            config,
            seeds=seeds,
            jobs=jobs or os.cpu_count() or 1,
            topics=topics,
            variants=compared or None,
            on_progress=progress,
        )
        write_outputs(folder, sweep)
    tables = []
    for title, (headings, *rows) in {
        "Loop closures": closure_table(sweep),
        "Trajectory and map": map_table(sweep),
    }.items():
        tables.append(console.grid({heading: index > 0 for index, heading in enumerate(headings)}, title=f"\n{title}"))
        for row in rows:
            tables[-1].add_row(*row)
    reused = len(sweep.results) - sweep.computed
    return Findings(
        results=sweep.to_json_dict(),
        parts=[
            *tables,
            NOTE,
            f"{sweep.computed} cells computed in {sweep.wall_s:.0f} s, {reused} were there before",
            f"written: {', '.join(str(folder / name) for name in (JSON_NAME, TABLE_NAME, *SHEET_NAMES, PICTURE_NAME))}",
        ],
        runs={cell.name: result.evaluation for cell, result in sweep.results if result.evaluation is not None},
        failures=sweep.failures,
        rules=Protocol().describe(),
    )
