"""dslam benchmark robots."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.tables import Markdown, report
from tools.replay import noted_counters

if TYPE_CHECKING:
    from slam.common.config import Config
    from slam.sweeps.mapped_drive import MappedDrive

COLUMNS = {
    "drive": "{name}",
    "odom. m": "{trajectory[odometry_ate_m]:.3f}",
    "ATE m": "{trajectory[ate_m]:.3f}",
    "landmarks": "{counters[landmarks_confirmed]}",
    "right %": "{associations[precision]:.1%}",
    "closures": "{closures[accepted_count]}",
    "precise %": "{closures[precision]:.1%}",
    "indep.": "{closures[independent_count]}|: {closures[largest_false_share]:.0%}",
    "recall %": "{closures[recall]:.1%}",
    "x real": "{speed:.1f}",
    "GB": "{gigabytes:.2f}",
}


def robots(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="Folder that contains drives, at any depth.")],
    drive: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this drive, or the drives in this folder. Repeatable."),
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
    revisits with a true closure. A dash: not defined.

    Example: dslam benchmark robots data/robots --drive evo --set keyframe.distance_m=1.5 --markdown
    """
    from slam.common.config import load_config
    from tools.lab.drives.robot_drives import find_drives

    config = load_config(config_file, settings)
    drives = find_drives(data, drive or ())
    runs, rows = {}, []
    for name, folder in drives.items():
        run = runs[name] = map_robot(folder, config)
        used = {} if run.error else {"speed": run.log_s / run.replay_s, "gigabytes": 1e-9 * run.peak_memory_bytes}
        rows.append({"name": name, **used, **run.evaluation})
        how = f"failed: {run.error}" if run.error else f"{run.replay_s:.0f} s"
        typer.echo(f"{len(runs)} of {len(drives)}: {name}, {how}", err=True)
    report(
        rows,
        *(f"{name}: {', '.join(notes)}" for name, run in runs.items() if (notes := notes_of(run))),
        columns=COLUMNS,
        markdown=markdown,
        json={"drives": [{"name": name, **asdict(run), "notes": notes_of(run)} for name, run in runs.items()]}
        if json
        else None,
    )


def map_robot(drive: Path, config: "Config") -> "MappedDrive":
    """Import the drive in a folder, map it in a process of its own and evaluate it."""
    from tempfile import TemporaryDirectory

    from logs.errors import LogError
    from slam.common.errors import SlamError
    from slam.sweeps.mapped_drive import DriveTask, MappedDrive, map_drive
    from slam.sweeps.workers import DIED, compute_all
    from tools.lab.drives.robot_drives import import_drive

    with TemporaryDirectory() as folder:
        log = Path(folder) / "drive.mcap"
        try:
            import_drive(drive, log)
        except (LogError, SlamError) as error:
            return MappedDrive(error=str(error))
        ((_, outcome),) = compute_all(map_drive, [DriveTask(log, config)], jobs=1)
    return outcome or MappedDrive(error=DIED)


def notes_of(run: "MappedDrive") -> list[str]:
    """The reason of a failure, what was counted, and a final status other than that all is well."""
    if run.error:
        return [run.error]
    doubts = run.reported[0].removeprefix("optimised").removeprefix("; ")
    return [*noted_counters(run.evaluation["counters"]), *filter(None, [doubts])]
