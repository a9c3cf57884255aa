"""dslam benchmark robots."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.tables import Columns, Markdown, figures_of, number, percent, report, with_progress
from tools.replay import noted_counters

if TYPE_CHECKING:
    from slam.common.config import Config
    from slam.sweeps.mapped_drive import MappedDrive
    from tools.lab.drives.robot_drives import RobotDrive

COLUMNS: Columns = {
    "odom. m": ("trajectory.odometry_ate_m", 3, 1.0),
    "ATE m": ("trajectory.ate_m", 3, 1.0),
    "landmarks": ("counters.landmarks_confirmed", 0, 1.0),
    "objects": ("associations.object_count", 0, 1.0),
    "right %": ("associations.precision", 1, 100.0),
    "closures": ("closures.accepted_count", 0, 1.0),
    "precise %": ("closures.precision", 1, 100.0),
    "indep.": ("closures.independent_count", 0, 1.0),
    "recall %": ("closures.recall", 1, 100.0),
    "known %": ("closures.recognised", 1, 100.0),
}


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
    reads them, packed by gzip or not. Each is imported, mapped in a fresh process and evaluated.

    ATE: aligned by SE(3). Objects: true objects that were detected. Right: precision of associations. Precise: that of
    closures. Indep.: independent closures, and the share of them that may be false with 95 % confidence. Recall:
    revisits with a true closure. Known: revisits recognised by a closure or by data association. A dash: not defined.

    Example: dslam benchmark robots data/robots --drive evo --set keyframe.distance_m=1.5 --markdown
    """
    from slam.common.config import load_config
    from tools.lab.drives.robot_drives import find_drives

    config = load_config(config_file, settings or ())
    drives = find_drives(data, drive or ())
    runs = list(with_progress((map_robot(each, config) for each in drives), len(drives)))
    report(
        [_row(run) for run in runs],
        *(f"{run.name}: {', '.join(notes)}" for run in runs if (notes := notes_of(run))),
        markdown=markdown,
        json={"drives": [{**asdict(run), "notes": notes_of(run)} for run in runs]} if json else None,
    )


def map_robot(drive: RobotDrive, config: Config) -> MappedDrive:
    """Import a drive, map it in a process of its own and evaluate it."""
    from tempfile import TemporaryDirectory

    from logs.errors import LogError
    from slam.common.errors import SlamError
    from slam.sweeps.mapped_drive import DriveTask, MappedDrive, map_drives
    from tools.lab.drives.robot_drives import import_drive

    with TemporaryDirectory() as folder:
        log = Path(folder) / "drive.mcap"
        try:
            import_drive(drive, log)
        except (LogError, SlamError) as error:
            return MappedDrive(drive.name, error=str(error))
        (run,) = map_drives([DriveTask(drive.name, log, config, Path(folder))])
    return run


def notes_of(run: MappedDrive) -> list[str]:
    """The reason of a failure, what was counted, and a final status other than that all is well."""
    if run.summary is None:
        return [run.error]
    doubts = run.summary.final_status.removeprefix("optimised").removeprefix("; ")
    return [*noted_counters(run.summary.counters), *filter(None, [doubts])]


def _row(run: MappedDrive) -> dict[str, str]:
    cells = figures_of(run, COLUMNS)
    if (false_share := run.figure("closures.largest_false_share")) is not None:
        cells["indep."] += f": {percent(false_share, 0)}"
    speed = run.summary.log_s / run.seconds if run.summary else None
    gigabytes = number(run.peak_memory_bytes if run.summary else None, 2, 1e-9)
    return {"drive": run.name, **cells, "x real": number(speed, 1), "GB": gigabytes}
