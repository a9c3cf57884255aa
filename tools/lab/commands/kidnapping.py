"""dslam benchmark kidnapping."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings


def kidnapping(
    objects: Annotated[Path, typer.Option(metavar="CSV", help="Objects of a world: x_m,y_m,z_m,class,id.")],
    trajectory: Annotated[Path, typer.Option(metavar="CSV", help="Tour through it: x_m,y_m.")],
    kidnaps: Annotated[int, typer.Option(min=1, help="Number of kidnappings.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the places and of all errors.")] = 0,
    config_file: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
) -> None:
    """Kidnap the robot while its odometry continues, and measure how soon it is detected.

    Each time it drives 150 m, is carried to another place of the tour without a gap or a jump of the odometry, and
    drives another 60 m.

    Example: dslam benchmark kidnapping --objects objects.csv --trajectory trajectory.csv
    """
    from slam.common.config import load_config
    from slam.simulation.world import load_world
    from tools import console
    from tools.lab.relocalization.silent import NOTICED_WITHIN_M, benchmark_silent_kidnapping

    world, config = load_world(objects, trajectory), load_config(config_file, settings or ())
    with console.progress_bar("carrying off", "carrying off") as move:
        result = benchmark_silent_kidnapping(world, config, kidnaps=kidnaps, seed=seed, on_progress=move)
    if json:
        console.show_json({**result, "seed": seed})
        return
    median = "-" if result["median_m"] is None else f"{result['median_m']:.1f} m"
    console.show(
        f"{result['world']}: {100 * result['noticed_rate']:.1f} % of {kidnaps} kidnappings noticed within "
        f"{NOTICED_WITHIN_M:g} m, median {median}; {result['false_alarms']} false alarms"
    )
