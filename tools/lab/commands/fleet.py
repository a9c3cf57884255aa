"""dslam benchmark fleet."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Jobs, Json

ROWS = {
    "logs": "{logs}, {unusable} of them damaged or of another town",
    "joined": "{joined} in {parts} maps, {unjoined} not; {false_joins} false",
    "landmarks": "{landmarks}, RMSE {rmse_m:.3f} m, median {median_m:.3f} m; in maps of "
    "single drives RMSE {single_rmse_m:.3f} m, median {single_median_m:.3f} m",
    "duplicates": "{duplicates:.2%}",
    "changes": "{changes_reported} reported, precision {change_precision:.3f}; "
    "{changes_true} passed by two drives both before and after, recall {change_recall:.3f}",
    "cost": "{wall_s:.0f} s, {processor_s:.0f} s of the processor; {session_mb:.2f} MB a session",
}


def fleet(
    folder: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of logs and maps.")],
    city: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Folder with objects.csv and trajectory.csv. Repeatable."),
    ] = None,
    drives: Annotated[int, typer.Option(min=1, help="Drives in each city and in the generated town.")] = 8,
    length: Annotated[float, typer.Option(min=50.0, help="Length of a drive.")] = 250.0,
    months: Annotated[int, typer.Option(min=1, help="Months over which the drives are spread.")] = 4,
    workers: Jobs = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulation.")] = 0,
    json: Json = False,
) -> None:
    """Simulate a fleet in cities that change from month to month, map it, and compare the map with the truth.

    Ten robots have different noise, a tenth of the objects changes each month, and a tenth of the logs is damaged or
    of another town.

    Example: dslam benchmark fleet -o out/fleet --drives 8 --city helsinki --city hamburg
    """
    from tools import console
    from tools.lab.fleets.run import benchmark_fleet
    from tools.lab.fleets.simulated_fleet import FleetPlan

    plan = FleetPlan(drives=drives, length_m=length, area_m=1.4 * length, months=months)
    jobs = workers or os.cpu_count() or 1
    tell = partial(typer.echo, err=True)
    figures = benchmark_fleet(folder, city or [], plan, workers=jobs, seed=seed, tell=tell)
    if json:
        console.show_json(figures)
    else:
        rows = {name: template.format_map(figures).replace("%", " %") for name, template in ROWS.items()}
        console.show(console.pairs(rows))
