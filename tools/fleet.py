"""dslam fleet."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import ConfigFile, Json, Settings

if TYPE_CHECKING:
    from slam.fleet.logs import FleetLog

NOT_MAPPED = 1
"""Exit code if a log could not be mapped."""


def fleet(
    logs: Annotated[
        list[str] | None, typer.Argument(metavar="[LOG]...", help="Logs, by path or URL.", show_default=False)
    ] = None,
    folder: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of maps and report; finished maps are kept.")
    ] = Path("fleet"),
    manifest: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Paths or URLs of more logs, one a line.", show_default=False)
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Tasks at a time. \\[default: one a core]", show_default=False)
    ] = None,
    address: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Address of a running Ray cluster.", show_default=False)
    ] = None,
    only: Annotated[bool, typer.Option("--only", help="Forget the logs of earlier runs that are not named.")] = False,
    origin: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON", help="Position on earth at which the first log begins.", show_default=False),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    status: Annotated[bool, typer.Option("--status", help="Show the last report and the logs that wait.")] = False,
    json: Json = False,
) -> None:
    """Map many logs of one city, find them in one another, and make one map of them.

    Logs are added to those of earlier runs in the same folder. Each log is mapped by itself; report.json says which
    joined where and which did not and why, changes.geojson what appeared, disappeared or moved. After an interruption
    the same command continues. --status shows the last report. The exit code is 1 if a log could not be mapped.

    Example: dslam fleet monday.mcap tuesday.mcap wednesday.mcap -o city
    """
    from slam.common.config import load_config
    from slam.fleet.engine import open_engine
    from slam.fleet.fleet import map_fleet
    from slam.fleet.logs import add_logs, find_logs
    from slam.fleet.report import fleet_report, read_report, write_report
    from tools import console

    if status:
        _finish(folder, read_report(folder), json=json)
        return
    from tools.importers.maps import parse_origin

    config = load_config(config_file, settings or ())
    georeference = parse_origin(origin)
    folder.mkdir(parents=True, exist_ok=True)
    members: list[FleetLog] = add_logs(folder, find_logs(logs or [], manifest, folder / "logs"), only=only)
    with (
        open_engine(workers or os.cpu_count() or 1, address=address) as engine,
        console.progress_line("fleet") as progress,
    ):
        result = map_fleet(
            members, folder, config, engine, georeference=georeference, progress=progress or _print_progress
        )
    write_report(folder, result)
    _finish(folder, fleet_report(result), json=json)


def _finish(folder: Path, report: dict[str, Any], *, json: bool) -> None:
    """Print a report; the exit code is that of the command."""
    from tools import console

    if json:
        console.show_json(report)
    else:
        _show(folder, report)
    if any(log["status"] == "not mapped" for log in report["logs"]):
        raise typer.Exit(NOT_MAPPED)


def _print_progress(_done: float, doing: str) -> None:
    typer.echo(doing, err=True)


def _show(folder: Path, report: dict[str, Any]) -> None:
    from slam.fleet.report import REPORT_NAME
    from tools import console

    table = console.grid(
        {"log": False, "status": False, "map": False, "joined": True, "warnings": True, "reason": False}
    )
    for log in report["logs"]:
        joined, notes = len(log.get("joined", [])), len(log.get("notes", []))
        table.add_row(log["log"], log["status"], log.get("map", ""), str(joined), str(notes), log.get("reason", ""))
    parts = console.grid(
        {"map": False, **dict.fromkeys(("logs", "landmarks", "there now", "sigma m", "changes"), True)}
    )
    for part in report["parts"]:
        parts.add_row(
            str(folder / part["map"]),
            str(part["logs"]),
            str(part["landmarks"]),
            str(part["present"]),
            f"{part['median_sigma_m']:.3f}",
            str(part["changes"]),
        )
    warnings = [f"{log['log']}: {note}" for log in report["logs"] for note in log.get("notes", [])]
    names = [*(part["map"] for part in report["parts"]), REPORT_NAME, "changes.geojson"]
    written = [str(folder / name) for name in names if (folder / name).exists()]
    console.show(table, parts, *warnings, f"written: {', '.join(written)}")
