"""dslam fleet."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import ConfigFile, Json, Settings, parse_origin
from tools.evaluation.output import Findings, report

if TYPE_CHECKING:
    from rich.console import RenderableType

    from slam.evaluation.requirements import Requirement

app = typer.Typer(help="Build one map of a city from many logs.", no_args_is_help=True)

Folder = Annotated[Path, typer.Argument(metavar="CITY", help="Folder of a fleet.", show_default=False)]
Require = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY<=NUMBER",
        help="Exit with 1 unless this condition (<= >= == < >) on the figures of the report holds. Repeatable.",
    ),
]


@app.command()
def add(
    city: Folder,
    logs: Annotated[
        list[str] | None, typer.Argument(metavar="[LOG]...", help="Logs to add.", show_default=False)
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Logs mapped at a time. \\[default: one per core]", show_default=False),
    ] = None,
    only: Annotated[bool, typer.Option("--only", help="Remove the logs of earlier runs that are not named.")] = False,
    origin: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON", help="Start of the first log, in latitude and longitude.", show_default=False),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    require: Require = None,
    json: Json = False,
) -> None:
    """Add logs to the map of a city; those of earlier runs stay.

    Each log is mapped by itself and localized in the earlier ones. report.json holds the result for each log with its
    reason, changes.geojson what appeared, disappeared or moved. After an interruption the same command continues. The
    exit code is 1 if a log could not be mapped.

    Example: dslam fleet add city monday.mcap tuesday.mcap --require "figures.map_median_sigma_m<=0.1"
    """
    from slam.common.config import load_config
    from slam.evaluation.requirements import parse_requirement
    from slam.fleet.fleet import map_fleet
    from slam.fleet.logs import add_logs, find_logs
    from slam.fleet.report import fleet_report, write_report

    requirements = [parse_requirement(text) for text in require or ()]
    if city.suffix and not city.is_dir():
        raise typer.BadParameter("name the folder of the city before the logs.", param_hint="CITY")
    config = load_config(config_file, settings or ())
    georeference = None if origin is None else parse_origin(origin)
    city.mkdir(parents=True, exist_ok=True)
    members = add_logs(city, find_logs(logs or []), only=only)
    jobs = workers or os.cpu_count() or 1
    result = map_fleet(members, city, config, workers=jobs, georeference=georeference, progress=_print_progress)
    write_report(city, result)
    _finish(city, fleet_report(result), requirements, json=json)


@app.command()
def status(city: Folder, require: Require = None, json: Json = False) -> None:
    """Show the last report of a fleet, and logs that are not mapped yet.

    Example: dslam fleet status city
    """
    from slam.evaluation.requirements import parse_requirement
    from slam.fleet.report import read_report

    _finish(city, read_report(city), [parse_requirement(text) for text in require or ()], json=json)


def _finish(city: Path, results: dict[str, Any], requirements: Sequence[Requirement], *, json: bool) -> None:
    """Print a report and whether it meets the requirements; the exit code is that of the command."""
    findings = Findings(results, _compose(city, results), {"": results})
    report(findings, requirements, as_json=json, with_rules=False, json_file=None)
    if any(log["status"] == "not mapped" for log in results["logs"]):
        raise typer.Exit(1)


def _print_progress(_done: float, doing: str) -> None:
    typer.echo(doing, err=True)


def _compose(city: Path, report: dict[str, Any]) -> list[RenderableType]:
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
            str(city / part["map"]),
            str(part["logs"]),
            str(part["landmarks"]),
            str(part["present"]),
            f"{part['median_sigma_m']:.3f}",
            str(part["changes"]),
        )
    warnings = [f"{log['log']}: {note}" for log in report["logs"] for note in log.get("notes", [])]
    names = [*(part["map"] for part in report["parts"]), REPORT_NAME, "changes.geojson"]
    written = [str(city / name) for name in names if (city / name).exists()]
    return [table, parts, *warnings, f"written: {', '.join(written)}"]
