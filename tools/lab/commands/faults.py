"""dslam benchmark faults."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Json, Settings, Topics, check_outputs, parse_topics
from tools.lab.tables import number, show, to_markdown
from tools.replay import noted_counters, rejected_by_odometry_note

if TYPE_CHECKING:
    from slam.sweeps.mapped_drive import MappedDrive

CLEAN = "none"


def faults(
    log: InputLog,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[=VALUE]", help="Only this fault. Repeatable; by default all."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.md", help="Write the table.", show_default=False),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 1,
    json: Json = False,
) -> None:
    """Map a drive with ground truth with one fault of its input at a time; measure the map and list what is reported.

    The faults are those of 'dslam degrade --list-faults'; the unchanged drive is measured first. Each run is a process
    of its own. Progress goes to standard error, a line for each fault.

    Example: dslam benchmark faults drive.mcap --only heading_jump --only time_offset=0.5 -o faults.md
    """
    chosen = parse_topics(topics)
    check_outputs([output], [log, config_file])
    from tempfile import TemporaryDirectory

    from logs.storage.placement import write_text
    from slam.common.config import load_config
    from slam.common.errors import EvaluationError
    from slam.evaluation.inputs.records import read_records
    from slam.simulation.faults.registry import all_cases
    from slam.sweeps.mapped_drive import DriveTask, map_drives
    from tools import console

    config = load_config(config_file, settings or ())
    names = [CLEAN, *(case.name for case in all_cases(only or ()))]
    if not read_records(log, topics=chosen).true_poses:
        raise EvaluationError(
            f"{log} holds no true poses (/ground_truth), so no error can be measured; give one that does"
        )
    runs: dict[str, MappedDrive] = {}
    with TemporaryDirectory() as folder:
        tasks = [
            DriveTask(name, log, config, Path(folder), chosen, () if name == CLEAN else (name,), seed) for name in names
        ]
        for run in map_drives(tasks, jobs=jobs):
            runs[run.name] = run
            _print_progress(run, len(runs), len(names))
            rows = [table_row(runs[name]) for name in names if name in runs]
            if output is not None:  # so that one that is interrupted is not lost
                title = f"# Faults of the input of {log.name}, seed {seed}"
                write_text(output, f"{title}\n\n{to_markdown(rows, texts=['reported'])}\n")
    if json:
        results = [
            {**asdict(runs[name]), "fault": name, "ate_m": runs[name].figure("trajectory.ate_m"),
             "reported": report_of(runs[name])}
            for name in names
        ]  # fmt: skip
        console.show_json({"log": str(log), "seed": seed, "runs": results})
    else:
        show(rows, *([f"written {output}"] if output is not None else []), texts=["reported"])


def table_row(run: MappedDrive) -> dict[str, str]:
    """The cells of a drive with a fault by their headings."""
    return {
        "fault": run.name,
        "ATE m": number(run.figure("trajectory.ate_m"), 3),
        "odometry ATE m": number(run.figure("trajectory.odometry_ate_m"), 3),
        "closures accepted": number(run.figure("closures.accepted_count"), 0),
        "precision": number(run.figure("closures.precision"), 3),
        "false": number(run.figure("closures.false_count"), 0),
        "landmarks": number(run.summary.counters.get("landmarks_confirmed", 0) if run.summary else None, 0),
        "reported": report_of(run),
        "s": number(run.seconds, 0),
    }


def report_of(run: MappedDrive) -> str:
    """What 'dslam replay' prints of the run beside its numbers: final status, warnings, closures removed, doubts."""
    if run.summary is None:
        return f"error: {run.error}"
    counters = run.summary.counters
    warnings = ", ".join(noted_counters(counters)) or "none"
    doubted = rejected_by_odometry_note(counters.get("closures_rejected_by_odometry", 0)).removeprefix("; ")
    removed = counters.get("closures_removed", 0)
    parts = [f"status: {run.summary.final_status}", f"warnings: {warnings}"]
    parts += [f"{removed} closures removed as outliers"] if removed else []
    parts += [doubted] if doubted else []
    parts += [f"of the log: {note}" for note in run.summary.notes]
    return "; ".join([*parts, *(f"on the way: {text}" for text in run.warnings if text != run.summary.final_status)])


def _print_progress(run: MappedDrive, done: int, total: int) -> None:
    row = table_row(run)
    measured = f"ATE {row['ATE m']} m, {row['closures accepted']} closures, {row['s']} s"
    what = f"error: {run.error}" if run.error else measured
    print(f"[{done}/{total}] {run.name}: {what}", file=sys.stderr, flush=True)
