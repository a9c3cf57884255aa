"""dslam benchmark relocalization."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings

if TYPE_CHECKING:
    from slam.benchmarks.relocalization_figures import Figures, RelocalizationBenchmark

HEADINGS = ("drives", "found", "late", "wrong", "lost", "m", "95 %", "s", "off m", "95 % off", "deg", "kept")


def relocalization(
    objects: Annotated[Path, typer.Option(metavar="CSV", help="Objects of a world: x_m,y_m,z_m,class,id.")],
    trajectory: Annotated[Path, typer.Option(metavar="CSV", help="Tour that is mapped: x_m,y_m.")],
    kidnaps: Annotated[int, typer.Option(min=1, help="How often the robot is carried off.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the map, the places and all errors.")] = 0,
    noise: Annotated[
        float, typer.Option(min=0.0, max=10.0, help="Factor on the errors of the sensor after the map was made.")
    ] = 1.0,
    changed: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the objects replaced after the map was made.")
    ] = 0.0,
    max_travel: Annotated[
        float, typer.Option("--max-travel", metavar="METRES", min=5.0, help="How long each drive is.")
    ] = 60.0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that search at a time.")] = 1,
    config_file: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
) -> None:
    """Map a tour, carry the robot off to random places of it, and tell how soon it knows where it is.

    It drives from there along the tour or against it, until objects of the map are recognised, and 10 m more. Found: a
    fix within 40 m that is right to 1 m and 3 deg; late: a right one after that; wrong: any other; lost: none at all.
    Distance and time are medians of right fixes, errors of all fixes; kept: right fixes that are still right 10 m on.

    Example: dslam benchmark relocalization --objects objects.csv --trajectory trajectory.csv --noise 2 --changed 0.1
    """
    from dataclasses import asdict

    from slam.benchmarks.relocalization import benchmark_relocalization
    from slam.config import load_config
    from slam.simulation.world import load_world
    from tools import console

    with console.progress_bar("carrying off", "carrying off") as move:
        result = benchmark_relocalization(
            load_world(objects, trajectory),
            load_config(config_file, settings or ()),
            kidnaps=kidnaps,
            seed=seed,
            noise=noise,
            changed=changed,
            max_travel_m=max_travel,
            jobs=jobs,
            on_progress=move,
        )
    if json:
        conditions = {"seed": seed, "noise": noise, "changed": changed, "max_travel_m": max_travel}
        told = asdict(result)
        console.show_json({**told.pop("total"), **conditions, **told})
    else:
        _show(result, f"noise x {noise:g}, {100 * changed:g} % of the objects changed")


def _show(result: RelocalizationBenchmark, conditions: str) -> None:
    from tools import console

    title = (
        f"{result.world}: {result.tour_m:.0f} m, {result.landmarks} landmarks, map ATE {result.map_ate_m:.2f} m; "
        f"{conditions}"
    )
    table = console.grid({"where": False, **dict.fromkeys(HEADINGS, True)}, title=title)
    for name, figures in {"everywhere": result.total, **result.groups}.items():
        table.add_row(name, *_row(figures))
    console.show(
        table,
        "found, late, wrong, lost and kept in per cent of the drives, kept of the right fixes",
        f"fixes at another place than in the map: {_number(result.total.misplaced_rate, 1, 100.0)} %; the others that "
        "are wrong are so because the map is",
        f"wrong fixes put right within 10 m, in per cent: {_number(result.total.taken_back_rate, 0, 100.0)}",
        f"taking in the map: {1e3 * result.load_s:.0f} ms; a search: {_number(result.query_ms, 1)} ms",
    )


def _row(figures: Figures) -> list[str]:
    rates = (figures.success_rate, figures.late_rate, figures.wrong_rate, figures.not_found_rate)
    return [
        str(figures.kidnaps),
        *(_number(rate, 1, 100.0) for rate in rates),
        _number(figures.median_distance_m, 1),
        _number(figures.p95_distance_m, 1),
        _number(figures.median_seconds, 1),
        _number(figures.median_error_m, 2),
        _number(figures.p95_error_m, 2),
        _number(figures.median_error_deg, 2),
        _number(figures.kept_rate, 0, 100.0),
    ]


def _number(value: float | None, digits: int, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"
