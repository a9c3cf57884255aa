"""dslam benchmark robots."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import ConfigFile, Json, Settings, check_outputs
from tools.replay import noted_counters

if TYPE_CHECKING:
    from tools.lab.drives.robot_runs import RobotRun

HEADINGS = {
    "odom. m": "odometry ATE m",
    "ATE m": "ATE m",
    "landmarks": "landmarks",
    "objects": "true objects",
    "right %": "associations right %",
    "closures": "closures",
    "precise %": "precision %",
    "indep.": "independent discoveries: false at most %",
    "recall %": "revisit recall %",
    "known %": "recognised %",
    "x real": "x real time",
    "GB": "peak GB",
}
"""Short headings, for a terminal, and full ones."""

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
    data: Annotated[Path, typer.Argument(metavar="DATA", help="Folder of drives, at any depth.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="OUT.md", help="Write the table as Markdown.", show_default=False),
    ] = None,
    drive: Annotated[
        list[str] | None,
        typer.Option("--drive", metavar="NAME", help="Only that drive, or those in that folder. Repeatable."),
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
    from dataclasses import asdict
    from importlib.metadata import version

    from slam.common.config import Config, load_config
    from slam.sweeps.cells import write_text
    from tools import console
    from tools.lab.drives.robot_drives import find_drives
    from tools.lab.drives.robot_runs import run_drives

    check_outputs([output], [config_file])
    config = load_config(config_file, settings or ())
    changed = dict(_differences(config.model_dump(mode="json"), Config().model_dump(mode="json")))
    drives = find_drives(data, drive or ())
    command = _command(data, drive or (), config_file, settings or ())
    runs: list[RobotRun] = []
    for number, run in enumerate(run_drives(drives, config), start=1):
        runs.append(run)
        how = f"{run.figures.wall_s:.0f} s" if run.figures else f"failed: {run.failure}"
        typer.echo(f"{number} of {len(drives)}: {run.drive}, {how}", err=True)
        if output is not None:  # after each drive, for they may take hours
            write_text(output, _markdown(runs, command, changed))
    if json:
        results = [{**asdict(run), "notes": _notes(run)} for run in runs]
        console.show_json({"version": version("descriptellation-slam"), "settings": changed, "drives": results})
    else:
        _show(runs)


def _show(runs: Sequence[RobotRun]) -> None:
    from tools import console

    table = console.grid({"drive": False, **dict.fromkeys(HEADINGS, True)})
    for run in runs:
        table.add_row(run.drive, *_cells(run))
    notes = [f"{run.drive}: {note}" for run in runs for note in _notes(run)]
    console.show(table, *notes)


def _cells(run: RobotRun) -> list[str]:
    from slam.evaluation.metrics.statistics import UNDEFINED

    f = run.figures
    if f is None:
        return ["failed", *[""] * (len(HEADINGS) - 1)]
    cells = (
        None if f.odometry_ate_m is None else f"{f.odometry_ate_m:.3f}",
        None if f.ate_m is None else f"{f.ate_m:.3f}",
        str(f.landmarks_confirmed),
        None if f.object_count is None else str(f.object_count),
        _percent(f.associations_precision),
        None if f.closures_accepted is None else str(f.closures_accepted),
        _percent(f.closures_precision),
        _discoveries(f.discoveries_independent, f.discoveries_false_share),
        _percent(f.revisit_recall),
        _percent(f.revisits_recognised),
        f"{f.real_time_factor:.1f}",
        f"{f.peak_memory_bytes / 1e9:.2f}",
    )
    return [UNDEFINED if cell is None else cell for cell in cells]


def _discoveries(independent: int | None, false_share: float | None) -> str | None:
    if independent is None or false_share is None:
        return None if independent is None else str(independent)
    return f"{independent}: {100.0 * false_share:.0f}"


def _percent(share: float | None) -> str | None:
    return None if share is None else f"{100.0 * share:.1f}"


def _notes(run: RobotRun) -> list[str]:
    """What went wrong: the reason of a failure, what was counted, and a status other than that all is well."""
    if run.figures is None:
        return [run.failure]
    counted = noted_counters(run.figures.counters)
    doubts = run.figures.final_status.removeprefix("optimised").removeprefix("; ")
    status = [doubts] if doubts else []
    return [", ".join(counted + status)] if counted or status else []


def _command(data: Path, names: Sequence[str], config_file: Path | None, settings: Sequence[str]) -> str:
    """The command without the folders that the figures do not depend on."""
    options = [part for name in names for part in ("--drive", name)]
    options += ["--config", config_file.name] if config_file else []
    options += [part for setting in settings for part in ("--set", setting)]
    return shlex.join(["dslam", "benchmark", "robots", data.name, *options])


def _differences(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The settings that are not the default, by their dotted names."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{key}", each) for key, each in _differences(value, defaults[name]))
        elif value != defaults[name]:
            yield name, value


def _markdown(runs: Sequence[RobotRun], command: str, changed: Mapping[str, Any]) -> str:
    from importlib.metadata import version

    headings = ("drive", *HEADINGS.values(), "warnings")
    settings = ", ".join(f"`{name}={value}`" for name, value in changed.items()) or "all default"
    lines = [
        "# Drives of several robots",
        "",
        f"Version {version('descriptellation-slam')}; settings: {settings}.",
        "",
        f"```\n{command}\n```",
        "",
        _line(headings),
        _line(["---", *["---:"] * len(HEADINGS), "---"]),
        *(_line([run.drive, *_cells(run), "; ".join(_notes(run)) or "none"]) for run in runs),
        "",
        EXPLANATION,
    ]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
