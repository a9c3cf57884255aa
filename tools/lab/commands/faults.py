"""dslam benchmark faults."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Json, Settings, Topics, parse_topics
from tools.lab.tables import Columns, Markdown, figures_of, number, report, with_progress
from tools.replay import noted_counters, rejected_by_odometry_note

if TYPE_CHECKING:
    from slam.sweeps.mapped_drive import MappedDrive

CLEAN = "none"
COLUMNS: Columns = {
    "ATE m": ("trajectory.ate_m", 3, 1.0),
    "odometry ATE m": ("trajectory.odometry_ate_m", 3, 1.0),
    "closures accepted": ("closures.accepted_count", 0, 1.0),
    "precision": ("closures.precision", 3, 1.0),
    "false": ("closures.false_count", 0, 1.0),
    "landmarks": ("counters.landmarks_confirmed", 0, 1.0),
}


def faults(
    log: InputLog,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[=VALUE]", help="Only this fault. Repeatable; by default all."),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 1,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Map a drive with ground truth with one fault of its input at a time; measure the map and list what is reported.

    The faults are those of 'dslam degrade --list-faults'; the unchanged drive is measured first. Each run is a process
    of its own. Progress goes to standard error, a line for each fault.

    Example: dslam benchmark faults drive.mcap --only heading_jump --only time_offset=0.5 --markdown
    """
    chosen = parse_topics(topics)
    from tempfile import TemporaryDirectory

    from slam.common.config import load_config
    from slam.common.errors import EvaluationError
    from slam.evaluation.inputs.records import read_records
    from slam.simulation.faults.registry import all_cases
    from slam.sweeps.mapped_drive import DriveTask, map_drives

    config = load_config(config_file, settings or ())
    names = [CLEAN, *(case.name for case in all_cases(only or ()))]
    if not read_records(log, topics=chosen).true_poses:
        raise EvaluationError(
            f"{log} holds no true poses (/ground_truth), so no error can be measured; give one that does"
        )
    with TemporaryDirectory() as folder:
        tasks = [
            DriveTask(name, log, config, Path(folder), chosen, () if name == CLEAN else (name,), seed) for name in names
        ]
        runs = {run.name: run for run in with_progress(map_drives(tasks, jobs=jobs), len(tasks))}
    ordered = [runs[name] for name in names]
    results = [{**asdict(run), "reported": report_of(run)} for run in ordered]
    report(
        [_row(run) for run in ordered],
        texts=["reported"],
        markdown=markdown,
        json={"log": str(log), "seed": seed, "runs": results} if json else None,
    )


def report_of(run: MappedDrive) -> str:
    """The final status, and what 'dslam replay' reports beside its numbers: warnings, removed closures, notes."""
    if run.summary is None:
        return f"error: {run.error}"
    counters, status = run.summary.counters, run.summary.final_status
    removed = counters.get("closures_removed", 0)
    parts = [status, *noted_counters(counters), f"{removed} closures removed as outliers" if removed else ""]
    parts += [rejected_by_odometry_note(counters.get("closures_rejected_by_odometry", 0)).removeprefix("; ")]
    parts += [*run.summary.notes, *(text for text in run.warnings if text != status)]
    return "; ".join(part for part in parts if part)


def _row(run: MappedDrive) -> dict[str, str]:
    return {
        "fault": run.name,
        **figures_of(run, COLUMNS),
        "reported": report_of(run),
        "s": number(run.seconds, 0),
    }
