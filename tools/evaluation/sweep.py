"""dslam sweep: one drive under many degradations."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Json, Settings, Topics, check_outputs, parse_topics
from tools.evaluation.output import Findings, JsonFile, Require, Rules, report


def sweep(
    log: InputLog,
    folder: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the results; finished ones are reused.")
    ],
    degrade: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE,...",
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
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes. \\[default: one per core]", show_default=False)
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

    After an interruption, the same command continues.

    Example: dslam sweep drive.mcap -o out/sweep --degrade dropout=0.5 --degrade dropout=0.8,max_range=30

    Example: dslam sweep drive.mcap -o out/descriptors --variant loop_closure.descriptor=gosmatch_vertex
    --variant loop_closure.descriptor=descriptellation_lr
    """
    chosen = parse_topics(topics)
    check_outputs([json_file], [log])
    from slam.common.config import load_config
    from slam.evaluation.inputs.protocol import Protocol
    from slam.evaluation.requirements import parse_requirement
    from slam.sweeps.degradations import parse_degradations
    from slam.sweeps.outputs import NOTE, make_tables, write_outputs
    from slam.sweeps.sweep import run_sweep
    from tools import console

    requirements = [parse_requirement(text) for text in require or ()]
    wanted = parse_degradations(degrade or ())
    config = load_config(config_file, settings or ())
    compared = {text: load_config(config_file, [*(settings or ()), *text.split(";")]) for text in variant or ()}
    with console.progress_bar("sweeping", "drawing") as progress:
        sweep = run_sweep(
            log,
            folder,
            wanted,
            config,
            seeds=seeds,
            jobs=jobs or os.cpu_count() or 1,
            topics=chosen,
            variants=compared or None,
            on_progress=progress,
        )
        written = write_outputs(folder, sweep)
    reused = len(sweep.results) - sweep.computed
    findings = Findings(
        results=sweep.to_json_dict(),
        parts=[
            *(console.frame(table, title=f"\n{title}") for title, table in make_tables(sweep).items()),
            NOTE,
            f"{sweep.computed} cells computed in {sweep.wall_s:.0f} s, {reused} reused",
            f"written: {', '.join(map(str, written))}",
        ],
        runs=sweep.evaluations,
        failures=sweep.failures,
        rules=Protocol().describe(),
    )
    report(findings, requirements, as_json=as_json, with_rules=rules, json_file=json_file)
