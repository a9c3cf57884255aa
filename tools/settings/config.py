"""dslam config."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings


def config(
    config_file: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
    made_from: Annotated[
        Path | None,
        typer.Option(
            "--from", metavar="MAP.mcap", help="Print the configuration of this map or log, with its calibration."
        ),
    ] = None,
    simulation: Annotated[bool, typer.Option("--simulation", help="Print the settings of 'dslam simulate'.")] = False,
) -> None:
    """Print the effective configuration with units and meaning, as TOML that --config reads back.

    Order of precedence: --set, the file, the defaults.

    Example: dslam config --set keyframe.distance_m=1.5 > mine.toml
    """
    from slam.common.config import Config
    from slam.common.config_tree import load_tree, to_toml
    from slam.simulation.config import SimulationConfig

    model = SimulationConfig if simulation else Config
    if made_from is None:
        tree = load_tree(model, config_file, settings)
    else:
        from logs.reader import LogReader
        from slam.object_map.map_io import METADATA
        from slam.provenance import recorded_config

        with LogReader(made_from) as reader:
            found = reader.metadata()
        tree = recorded_config(found.get("dslam") or found.get(METADATA) or {})
    sys.stdout.write(tree.model_dump_json(indent=2) + "\n" if json else to_toml(tree))
