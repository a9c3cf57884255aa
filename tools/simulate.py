"""dslam simulate."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, NewLog, Settings, check_outputs

if TYPE_CHECKING:
    from slam.simulation.world import World


def simulate(
    output: NewLog,
    objects: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Objects of a world of your own: x_m,y_m,z_m,class,id.")
    ] = None,
    trajectory: Annotated[Path | None, typer.Option(metavar="CSV", help="Tour through that world: x_m,y_m.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all errors, and of the town without --world-seed.")] = 0,
    world_seed: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Seed of the town, for several drives through one town.")
    ] = None,
    length: Annotated[float | None, typer.Option(metavar="M", help="Length of the drive.")] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
) -> None:
    """Simulate a drive: drifting odometry, noisy detections, and the truth.

    Without CSV files the world is a generated town of 4 x 3 blocks.

    Example: dslam simulate drive.mcap --seed 3 --set sensor.dropout=0.3
    """
    check_outputs([output], [objects, trajectory, config_file])
    from slam.common.config_tree import load_tree
    from slam.simulation.config import SimulationConfig
    from slam.simulation.simulation import write_simulation
    from tools import console

    config = load_tree(SimulationConfig, config_file, settings)
    world = load_or_generate(objects, trajectory, seed=seed if world_seed is None else world_seed)
    if length is not None:
        world = world.shortened(length)
    summary = write_simulation(output, world, config, seed=seed)
    made = {"output": output, "world": world.name, "seed": seed, "object_count": len(world.object_ids)}
    console.report({**made, **asdict(summary)}, as_json=json)


def load_or_generate(objects: Path | None, trajectory: Path | None, *, seed: int) -> "World":
    """The world in two CSV files, or the generated town with a seed.

    Raises:
        BadParameter: only one of the files is given.
    """
    import numpy as np

    from slam.simulation.street_grid import generate_street_grid
    from slam.simulation.world import load_world

    if objects is not None and trajectory is not None:
        return load_world(objects, trajectory)
    if objects is not trajectory:
        raise typer.BadParameter("--objects and --trajectory belong together; give both or neither.")
    return generate_street_grid(rng=np.random.default_rng(seed))
