"""dslam config."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings


def config(
    config_file: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
    toml: Annotated[bool, typer.Option("--toml", help="Print TOML; this is what happens anyway.")] = False,
    simulation: Annotated[bool, typer.Option("--simulation", help="The settings of 'dslam simulate' instead.")] = False,
) -> None:
    """Print the effective configuration with units and meaning, as TOML that --config reads back.

    Defaults, then the file, then --set: the later wins.

    Example: dslam config --set keyframe.distance_m=1.5 > mine.toml
    """
    if json and toml:
        raise typer.BadParameter("--json and --toml exclude each other.")
    from slam.common.config import load_config
    from slam.common.config_tree import to_toml
    from slam.simulation.config import load_simulation_config

    load = load_simulation_config if simulation else load_config
    tree = load(config_file, settings or ())
    sys.stdout.write(tree.model_dump_json(indent=2) + "\n" if json else to_toml(tree))
