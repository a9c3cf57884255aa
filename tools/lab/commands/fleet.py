"""dslam benchmark fleet."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json
from tools.lab.tables import Markdown, number, report

if TYPE_CHECKING:
    from tools.lab.fleets.simulated_fleet import FleetPlan


def fleet(
    folder: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of logs and maps.")],
    city: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Folder with objects.csv and trajectory.csv. Repeatable.", show_default=False),
    ] = None,
    drives: Annotated[int, typer.Option(min=1, help="Drives in each city and in the generated town.")] = 8,
    length: Annotated[float, typer.Option(min=50.0, help="Length of a drive.")] = 250.0,
    months: Annotated[int, typer.Option(min=1, help="Months over which the drives are spread.")] = 4,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Tasks at a time. \\[default: one per core]", show_default=False)
    ] = None,
    nights: Annotated[
        int | None,
        typer.Option(min=1, help="Add the drives of the generated town night by night.", show_default=False),
    ] = None,
    killed: Annotated[
        list[int] | None, typer.Option(min=1, help="A night whose run is killed and started again. Repeatable.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulation.")] = 0,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Simulate a fleet in cities that change from month to month, map it, and compare the map with the truth.

    Ten robots have different noise, a tenth of the objects changes each month, and a tenth of the logs is damaged or
    of another town. With --nights the fleet grows night by night, and is compared with the same logs mapped at once;
    --markdown is for that table.

    Example: dslam benchmark fleet -o out/fleet --drives 8 --city helsinki --city hamburg
    """
    from dataclasses import asdict
    from functools import partial

    from slam.fleet.tasks import compute_in_processes
    from tools import console
    from tools.lab.fleets.run import benchmark_fleet
    from tools.lab.fleets.simulated_fleet import FleetPlan

    plan = FleetPlan(drives=drives, length_m=length, area_m=1.4 * length, months=months)
    if nights is not None:
        _show_nights(folder, plan, nights, killed or (), seed, markdown=markdown, json=json)
        return
    compute = partial(compute_in_processes, workers=workers or os.cpu_count() or 1)
    with console.progress_line("fleet") as progress:
        score, cost = benchmark_fleet(
            folder, city or [], plan, compute, seed=seed, **({"progress": progress} if progress else {})
        )
    if json:
        console.show_json({**asdict(score), **asdict(cost)})
        return
    console.show(
        console.pairs(
            {
                "logs": f"{score.logs}, {score.unusable} of them damaged or of another town",
                "joined": f"{score.joined} in {score.parts} maps, {score.unjoined} not; {score.false_joins} false",
                "landmarks": f"{score.landmarks}, RMSE {score.rmse_m:.3f} m, median {score.median_m:.3f} m; in maps of "
                f"single drives RMSE {score.single_rmse_m:.3f} m, median {score.single_median_m:.3f} m",
                "duplicates": f"{100 * score.duplicates:.2f} %",
                "changes": f"{score.changes_reported} reported, precision {score.change_precision:.3f}; "
                f"{score.changes_true} that two drives before and after could show, recall {score.change_recall:.3f}",
                "cost": f"{cost.wall_s:.0f} s; mapping {cost.mapping_s:.0f} s, finding places {cost.finding_s:.0f} s, "
                f"joining {cost.joining_s:.0f} s of the processor; {cost.session_mb:.2f} MB a session",
            }
        )
    )


def _show_nights(
    folder: Path, plan: FleetPlan, nights: int, killed: Sequence[int], seed: int, *, markdown: bool, json: bool
) -> None:
    from dataclasses import asdict

    from tools import console
    from tools.lab.fleets.nights import benchmark_nights

    with console.progress_line("fleet") as progress:
        grown = benchmark_nights(
            folder, plan, nights, killed=killed, seed=seed, **({"progress": progress} if progress else {})
        )
    of_nights = [
        {
            "night": str(number_of_night),
            "logs": str(night.logs),
            "processor s": number(night.processor_s, 1),
            "memory MB": number(night.memory_mb, 0),
            "killed": "yes" if night.was_killed else "no",
        }
        for number_of_night, night in enumerate(grown.nights, start=1)
    ]
    figures = [
        {"figure": name.replace("_", " "), "night by night": f"{value:.4g}", "at once": f"{at_once:.4g}"}
        for (name, value), at_once in zip(
            asdict(grown.night_by_night).items(), asdict(grown.at_once).values(), strict=True
        )
    ]
    if json:
        console.show_json(asdict(grown))
        return
    report(of_nights, markdown=markdown)
    typer.echo()
    report(figures, markdown=markdown)
