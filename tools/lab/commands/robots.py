"""dslam benchmark robots."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.tables import Markdown, number, percent, report
from tools.replay import noted_counters

if TYPE_CHECKING:
    from slam.common.config import Config
    from slam.sweeps.mapped_drive import MappedDrive
    from tools.lab.drives.robot_drives import RobotDrive

COLUMNS = {
    "odom. m": ("trajectory.odometry_ate_m", 3, 1.0),
    "ATE m": ("trajectory.ate_m", 3, 1.0),
    "landmarks": ("counters.landmarks_confirmed", 0, 1.0),
    "right %": ("associations.precision", 1, 100.0),
    "closures": ("closures.accepted_count", 0, 1.0),
    "precise %": ("closures.precision", 1, 100.0),
    "indep.": ("closures.independent_count", 0, 1.0),
    "recall %": ("closures.recall", 1, 100.0),
    "known %": ("closures.recognised", 1, 100.0),
}
"""Heading -> key of a figure in an evaluation's JSON, digits, and factor."""


def robots(
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="Folder that contains drives, at any depth.", show_default=False)
    ],
    drive: Annotated[
        list[str] | None,
        typer.Option("--drive", metavar="NAME", help="Only this drive, or the drives in this folder. Repeatable."),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Map whole drives of several robots and compare each with its truth.

    A drive is a folder with odometry.tum, detections.csv and, for the errors, groundtruth.tum, as 'dslam import csv'
    reads them, optionally compressed with gzip. Each is imported, mapped in a fresh process and evaluated.

    ATE: aligned by SE(3). Right: precision of associations. Precise: that of
    closures. Indep.: independent closures, and the share of them that may be false with 95 % confidence. Recall:
    revisits with a true closure. Known: revisits recognised by a closure or by data association. A dash: not defined.

    Example: dslam benchmark robots data/robots --drive evo --set keyframe.distance_m=1.5 --markdown
    """
    from slam.common.config import load_config
    from tools.lab.drives.robot_drives import find_drives

    config = load_config(config_file, settings or ())
    drives = find_drives(data, drive or ())
    runs: dict[str, MappedDrive] = {}
    for each in drives:
        run = runs[each.name] = map_robot(each, config)
        how = f"failed: {run.error}" if run.error else f"{run.replay_s:.0f} s"
        typer.echo(f"{len(runs)} of {len(drives)}: {each.name}, {how}", err=True)
    report(
        [_row(name, run) for name, run in runs.items()],
        *(f"{name}: {', '.join(notes)}" for name, run in runs.items() if (notes := notes_of(run))),
        markdown=markdown,
        json={"drives": [{"name": name, **asdict(run), "notes": notes_of(run)} for name, run in runs.items()]}
        if json
        else None,
    )


def map_robot(drive: RobotDrive, config: Config) -> MappedDrive:
    """Import a drive, map it in a process of its own and evaluate it."""
    from tempfile import TemporaryDirectory

    from logs.errors import LogError
    from slam.common.errors import SlamError
    from slam.sweeps.mapped_drive import DriveTask, MappedDrive, map_drive
    from slam.sweeps.workers import Death, compute_all
    from tools.lab.drives.robot_drives import import_drive

    with TemporaryDirectory() as folder:
        log = Path(folder) / "drive.mcap"
        try:
            import_drive(drive, log)
        except (LogError, SlamError) as error:
            return MappedDrive(error=str(error))
        ((_, outcome),) = compute_all(map_drive, [DriveTask(log, config)], jobs=1, fresh=True)
    return MappedDrive(error=str(outcome)) if isinstance(outcome, Death) else outcome


def notes_of(run: MappedDrive) -> list[str]:
    """The reason of a failure, what was counted, and a final status other than that all is well."""
    if run.error:
        return [run.error]
    doubts = run.reported[0].removeprefix("optimised").removeprefix("; ")
    return [*noted_counters(run.evaluation["counters"]), *filter(None, [doubts])]


def _row(name: str, run: MappedDrive) -> dict[str, str]:
    cells = {heading: number(run.figure(key), digits, factor) for heading, (key, digits, factor) in COLUMNS.items()}
    if (false_share := run.figure("closures.largest_false_share")) is not None:
        cells["indep."] += f": {percent(false_share, 0)}"
    speed = None if run.error else run.log_s / run.replay_s
    gigabytes = number(None if run.error else run.peak_memory_bytes, 2, 1e-9)
    return {"drive": name, **cells, "x real": number(speed, 1), "GB": gigabytes}
