"""dslam benchmark faults."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Json, Settings, Topics, check_outputs, parse_topics
from tools.replay import noted_counters, rejected_by_odometry_note

if TYPE_CHECKING:
    from tools.lab.drives.fault_runs import FaultRun


def faults(
    log: InputLog,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[=VALUE]", help="Only that fault. Repeatable; without it all of them."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.md", help="Write the table.", show_default=False),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of what is random in the faults.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 1,
    json: Json = False,
) -> None:
    """Put faults into the input of a drive with truth, map it with each, and measure the map and what is reported.

    The faults are those of 'dslam degrade --list-faults'. Each is mapped in a process of its own, and so is the drive
    as it is. Progress goes to standard error, a line for each fault.

    Example: dslam benchmark faults drive.mcap --only heading_jump --only time_offset=0.5 -o faults.md
    """
    chosen = parse_topics(topics)
    check_outputs([output], [log, config_file])
    from dataclasses import asdict

    from slam.common.config import load_config
    from slam.simulation.faults.registry import all_cases
    from tools import console
    from tools.lab.drives.fault_runs import CLEAN, benchmark_faults

    config = load_config(config_file, settings or ())
    cases = all_cases(only or ())
    order = [CLEAN, *(case.name for case in cases)]
    runs: dict[str, FaultRun] = {}
    for run in benchmark_faults(log, cases, config, seed=seed, jobs=jobs, topics=chosen):
        runs[run.fault] = run
        _print_progress(run, len(runs), len(order))
        finished = [runs[name] for name in order if name in runs]
        if output is not None:
            _write(output, log, seed, finished)
    if json:
        rows = [{**asdict(run), "reported": report_of(run)} for run in finished]
        console.show_json({"log": str(log), "seed": seed, "runs": rows})
    else:
        _show(finished, output)


def report_of(run: FaultRun) -> str:
    """What 'dslam replay' prints of the run beside its numbers: final status, warnings, closures taken out, doubts."""
    warnings = ", ".join(noted_counters(run.counters)) or "none"
    doubted = rejected_by_odometry_note(run.counters.get("closures_rejected_by_odometry", 0)).removeprefix("; ")
    withdrawn = run.counters.get("closures_removed", 0)
    said = [f"status: {run.final_status}", f"warnings: {warnings}"]
    said += [f"{withdrawn} closures removed as outliers"] if withdrawn else []
    said += [doubted] if doubted else []
    said += [f"of the log: {note}" for note in run.notes]
    return "; ".join([*said, *(f"on the way: {text}" for text in run.warnings if text != run.final_status)])


def _print_progress(run: FaultRun, done: int, total: int) -> None:
    from tools.lab.drives.fault_table import HEADINGS, table_row

    cells = dict(zip(HEADINGS, table_row(run, ""), strict=True))
    measured = f"ATE {cells['ATE m']} m, {cells['closures accepted']} closures, {cells['s']} s"
    what = f"error: {run.error}" if run.error else measured
    print(f"[{done}/{total}] {run.fault}: {what}", file=sys.stderr, flush=True)


def _write(output: Path, log: Path, seed: int, runs: list[FaultRun]) -> None:
    """The table so far, so that one that is interrupted is not lost."""
    from slam.sweeps.cells import write_text
    from tools.lab.drives.fault_table import render_markdown, table_row

    write_text(output, render_markdown(log, seed, [table_row(run, report_of(run)) for run in runs]))


def _show(runs: list[FaultRun], output: Path | None) -> None:
    from tools import console
    from tools.lab.drives.fault_table import HEADINGS, table_row

    table = console.grid({heading: heading not in ("fault", "reported") for heading in HEADINGS})
    for run in runs:
        table.add_row(*table_row(run, report_of(run)))
    console.show(table, *([f"written {output}"] if output is not None else []))
