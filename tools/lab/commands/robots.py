"""dslam benchmark robots."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import ConfigFile, Json, Settings, check_outputs
from tools.lab.tables import number, percent, show, to_markdown
from tools.replay import noted_counters

if TYPE_CHECKING:
    from slam.common.config import Config
    from slam.sweeps.mapped_drive import MappedDrive
    from tools.lab.drives.robot_drives import RobotDrive

EXPLANATION = """\
ATE: root mean square error of the positions, aligned by SE(3), of the odometry and of the final trajectory.
Landmarks: those confirmed in the final map, beside the true objects that were detected. Associations: assignments of
detections to the landmark that shows their object. Closures: those accepted, how many of them are right, how many
found places have no object in common, the share of these that may be false with 95 % confidence (the rule of three),
and at how many revisits there is a right one (a revisit comes after at least 100 m of travel). Recognised: those, and
revisits at which landmarks of the earlier traversal are still associated, at the right pose. Memory is the peak of the
replay.
A dash is a figure that the drive or its truth does not tell. A replay draws its random numbers from what is in the
log and has no seed: the same log and settings give the same map.
"""


def robots(
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="Folder that contains drives, at any depth.", show_default=False)
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="OUT.md", help="Write the table as Markdown.", show_default=False),
    ] = None,
    drive: Annotated[
        list[str] | None,
        typer.Option("--drive", metavar="NAME", help="Only this drive, or the drives in this folder. Repeatable."),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
) -> None:
    """Map whole drives of several robots and compare each with its truth.

    A drive is a folder with odometry.tum, detections.csv and, for the errors, groundtruth.tum, as 'dslam import csv'
    reads them, packed by gzip or not. Each is imported, mapped in a fresh process and evaluated.

    Example: dslam benchmark robots data/robots -o robots.md --drive evo --set keyframe.distance_m=1.5
    """
    from importlib.metadata import version

    from logs.storage.placement import write_text
    from slam.common.config import Config, load_config
    from slam.common.config_tree import changes
    from tools import console
    from tools.lab.drives.robot_drives import find_drives

    check_outputs([output], [config_file])
    config = load_config(config_file, settings or ())
    changed = changes(Config(), config.model_dump_json())
    drives = find_drives(data, drive or ())
    command = _command(data, drive or (), config_file, settings or ())
    runs: list[MappedDrive] = []
    for done, run in enumerate((map_robot(each, config) for each in drives), start=1):
        runs.append(run)
        how = f"failed: {run.error}" if run.error else f"{run.seconds:.0f} s"
        typer.echo(f"{done} of {len(drives)}: {run.name}, {how}", err=True)
        if output is not None:  # after each drive, for they may take hours
            write_text(output, _page(runs, command, changed))
    if json:
        results = [
            {"drive": run.name, "figures": figures_of(run) or None, "failure": run.error, "notes": _notes(run)}
            for run in runs
        ]
        console.show_json({"version": version("descriptellation-slam"), "settings": changed, "drives": results})
    else:
        show([_row(run) for run in runs], *(f"{run.name}: {note}" for run in runs for note in _notes(run)))


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


def figures_of(run: MappedDrive) -> dict[str, Any]:
    """The figures of a drive by name, None where the drive or its truth leaves one undefined; none of a failure."""
    if run.summary is None:
        return {}
    has_closures = run.evaluation.get("closures") is not None
    return {
        "odometry_ate_m": run.figure("trajectory.odometry_ate_m"),
        "ate_m": run.figure("trajectory.ate_m"),
        "landmarks_confirmed": run.summary.counters.get("landmarks_confirmed", 0),
        "object_count": run.figure("associations.object_count"),
        "associations_precision": run.figure("associations.precision"),
        "closures_accepted": run.figure("closures.accepted_count") if has_closures else None,
        "closures_precision": run.figure("closures.precision"),
        "discoveries_independent": run.figure("closures.independent_count"),
        "discoveries_false_share": run.figure("closures.largest_false_share"),
        "revisit_recall": run.figure("closures.recall"),
        "revisits_recognised": run.figure("closures.recognised"),
        "log_s": run.summary.log_s,
        "wall_s": run.seconds,
        "peak_memory_bytes": run.peak_memory_bytes,
        "counters": dict(run.summary.counters),
        "final_status": run.summary.final_status,
    }


def _row(run: MappedDrive, *, in_full: bool = False) -> dict[str, str]:
    cells = _cells(figures_of(run), in_full=in_full)
    if run.summary is None:
        cells = dict.fromkeys(cells, "") | {next(iter(cells)): "failed"}
    return {"drive": run.name, **cells}


def _cells(figures: Mapping[str, Any], *, in_full: bool) -> dict[str, str]:
    """Figures by their headings, short ones for a terminal."""
    get = figures.get
    independent, false_share = get("discoveries_independent"), get("discoveries_false_share")
    discoveries = number(independent, 0) + ("" if false_share is None else f": {100.0 * false_share:.0f}")
    speed = figures["log_s"] / figures["wall_s"] if figures else None
    cells = {
        ("odom. m", "odometry ATE m"): number(get("odometry_ate_m"), 3),
        ("ATE m", "ATE m"): number(get("ate_m"), 3),
        ("landmarks", "landmarks"): number(get("landmarks_confirmed"), 0),
        ("objects", "true objects"): number(get("object_count"), 0),
        ("right %", "associations right %"): percent(get("associations_precision")),
        ("closures", "closures"): number(get("closures_accepted"), 0),
        ("precise %", "precision %"): percent(get("closures_precision")),
        ("indep.", "independent discoveries: false at most %"): discoveries,
        ("recall %", "revisit recall %"): percent(get("revisit_recall")),
        ("known %", "recognised %"): percent(get("revisits_recognised")),
        ("x real", "x real time"): number(speed, 1),
        ("GB", "peak GB"): number(get("peak_memory_bytes"), 2, 1e-9),
    }
    return {heading[in_full]: cell for heading, cell in cells.items()}


def _notes(run: MappedDrive) -> list[str]:
    """The reason of a failure, what was counted, and a final status other than that all is well."""
    if run.summary is None:
        return [run.error]
    counted = noted_counters(run.summary.counters)
    doubts = run.summary.final_status.removeprefix("optimised").removeprefix("; ")
    notes = [*counted, *([doubts] if doubts else [])]
    return [", ".join(notes)] if notes else []


def _command(data: Path, names: Sequence[str], config_file: Path | None, settings: Sequence[str]) -> str:
    """The command without the folders that the figures do not depend on."""
    options = [part for name in names for part in ("--drive", name)]
    options += ["--config", config_file.name] if config_file else []
    options += [part for setting in settings for part in ("--set", setting)]
    return shlex.join(["dslam", "benchmark", "robots", data.name, *options])


def _page(runs: Sequence[MappedDrive], command: str, changed: Sequence[str]) -> str:
    from importlib.metadata import version

    settings = ", ".join(f"`{each}`" for each in changed) or "all default"
    rows = [{**_row(run, in_full=True), "warnings": "; ".join(_notes(run)) or "none"} for run in runs]
    head = f"Version {version('descriptellation-slam')}; settings: {settings}.\n\n```\n{command}\n```"
    return "\n\n".join(["# Drives of several robots", head, to_markdown(rows, texts=["warnings"]), EXPLANATION])
