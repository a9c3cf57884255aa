"""dslam relocalize."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import (
    CalibrationFile,
    ConfigFile,
    InputLog,
    Json,
    Output,
    Picture,
    Settings,
    Topics,
    check_outputs,
    parse_topics,
)
from tools.pictures import draw_drive
from tools.replay import describe

if TYPE_CHECKING:
    from slam.place_recognition.initial_pose import InitialPose


def relocalize(
    source: InputLog,
    map_log: Annotated[
        Path, typer.Option("--map", metavar="MAP.mcap", help="The map in which the robot is localized.")
    ],
    output: Output,
    near: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y[,YAW],SIGMA",
            help="Where the robot starts: metres in the map, degrees from its x axis, metres.",
        ),
    ] = None,
    config_file: ConfigFile = None,
    calibration: CalibrationFile = None,
    settings: Settings = None,
    topics: Topics = None,
    json: Json = False,
    picture: Picture = None,
) -> None:
    """Localize a robot in a saved or imported map; the map does not change.

    --near restricts the search to 3.5 SIGMA plus the distance driven since, and, if YAW is given, to headings within
    52 deg.

    Poses are on /slam/pose from the first fix on, recognised keyframes with their covariances on
    /slam/closures, and changes of the state on /slam/status. Exits with 1 if the robot was never localized.

    Example: dslam relocalize tuesday.mcap --map monday_map.mcap -o tuesday_found.mcap --near 120,-35,90,10
    """
    chosen, prior = parse_topics(topics), _parsed_prior(near)
    check_outputs([output, picture], [source, config_file, calibration, map_log])
    from slam.common.config import load_config
    from slam.localization.prior_map import load_prior_map
    from slam.replay import replay
    from tools import console

    config = load_config(config_file, settings, calibration=calibration)
    known = load_prior_map(map_log)
    with console.progress_bar("looking", "optimising") as progress:
        summary = replay(
            source, output, config, topics=chosen, prior_map=known, initial_pose=prior, extend=False, progress=progress
        )
    is_found = bool(summary.relocalization_times_s)
    if picture is not None and is_found:
        draw_drive(output, picture)
    if json:
        console.show_json({"output": str(output), "found": is_found, **asdict(summary)})
    else:
        counters, rows = Counter(summary.counters), describe(summary)
        shown = {
            "found": rows.get("found", "never: no place of the map was recognised"),
            "recognised": f"{counters['keyframes_recognised']} of {counters['keyframes']} keyframes",
            "tracked": f"{100 * summary.tracked_ratio:.0f} % of the online poses were in the map frame",
            "kidnapped": f"detected {counters['kidnappings_detected']} times; "
            f"{counters['relocalizations_revoked']} relocalizations revoked",
            "warnings": rows["warnings"],
            "final status": summary.final_status,
            "written": str(output) + (f", {picture}" if picture and is_found else ""),
        }
        console.show(console.pairs(shown))
    if not is_found:
        raise typer.Exit(1)


def _parsed_prior(near: str | None) -> "InitialPose | None":
    import numpy as np

    from slam.common.errors import InputDataError
    from slam.place_recognition.initial_pose import InitialPose

    if near is None:
        return None
    try:
        x_m, y_m, *yaw_deg, sigma_m = (float(part) for part in near.split(","))
        (yaw_rad,) = np.deg2rad(yaw_deg).tolist() or [None]
        return InitialPose(np.array([x_m, y_m]), sigma_m, yaw_rad=yaw_rad)
    except (ValueError, InputDataError):
        raise typer.BadParameter(
            f"{near!r} is not X,Y,SIGMA or X,Y,YAW,SIGMA in metres and degrees, as in 120,-35,90,10.",
            param_hint="--near",
        ) from None
