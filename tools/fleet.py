"""dslam fleet."""

import os
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import ConfigFile, Jobs, Json, Settings, parse_origin
from tools.evaluation.requirements import Require, finish

app = typer.Typer(no_args_is_help=True)

FIGURES = ("map", "logs", "landmarks", "present", "median_sigma_m", "changes")
"""Of a part of the map, in the order of the table."""
Folder = Annotated[Path, typer.Argument(metavar="CITY", help="Folder of a fleet.")]


@app.callback()
def fleet() -> None:
    """Build one map of a city from many logs."""


@app.command()
def add(
    city: Folder,
    logs: Annotated[list[str] | None, typer.Argument(metavar="[LOG]...", help="Logs to add.")] = None,
    workers: Jobs = None,
    only: Annotated[bool, typer.Option("--only", help="Remove the logs of earlier runs that are not named.")] = False,
    origin: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON", help="Start of the earliest log, in latitude and longitude; kept for later runs."
        ),
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
    from slam.fleet.fleet import REPORT_NAME, map_fleet, write_report
    from slam.fleet.sessions import add_logs, find_logs
    from tools import console

    if city.suffix and not city.is_dir():
        raise typer.BadParameter("name the folder of the city before the logs.", param_hint="CITY")
    config = load_config(config_file, settings)
    georeference = None if origin is None else parse_origin(origin)
    city.mkdir(parents=True, exist_ok=True)
    members = add_logs(city, find_logs(logs or []), only=only)
    result = map_fleet(
        members,
        city,
        config,
        workers=workers or os.cpu_count() or 1,
        georeference=georeference,
        tell=partial(typer.echo, err=True),
    )
    report = write_report(city, result)
    if json:
        console.show_json(report)
    else:
        names = [*(part["map"] for part in report["parts"]), REPORT_NAME, "changes.geojson"]
        columns = ("log", "status", "map", "reason")
        console.show(
            console.table(console.rows(report["logs"], columns), texts=columns),
            console.table(console.rows(report["parts"], FIGURES)),
            *(f"{log['log']}: {note}" for log in report["logs"] for note in log.get("notes", [])),
            f"written: {', '.join(str(city / name) for name in names)}",
        )
    finish({"": report}, require, quiet=json)
    if any(log["status"] == "not mapped" for log in report["logs"]):
        raise typer.Exit(1)
