"""dslam relocalize."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import (
    CalibrationFile,
    ConfigFile,
    InputLog,
    Json,
    Picture,
    Settings,
    Topics,
    check_outputs,
    parse_topics,
)
from tools.pictures import draw_drive

if TYPE_CHECKING:
    from slam.place_recognition.initial_pose import InitialPose
    from slam.replay import ReplaySummary


def relocalize(
    source: InputLog,
    map_log: Annotated[
        Path, typer.Option("--map", metavar="MAP.mcap", help="The map in which the robot is localized.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="The log to write.")],
    near: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y[,YAW],SIGMA",
            help="Where the robot starts: metres in the map, degrees from its x axis, metres.",
            show_default=False,
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
    /slam/relocalizations, and changes of the state on /slam/status. Exits with 1 if the robot was never localized.

    Example: dslam relocalize tuesday.mcap --map monday_map.mcap -o tuesday_found.mcap --near 120,-35,90,10
    """
    chosen, prior = parse_topics(topics), _parsed_prior(near)
    check_outputs([output, picture], [source, config_file, calibration, map_log])
    from slam.common.config import load_config
    from slam.localization.prior_map import load_prior_map
    from slam.replay import replay
    from tools import console

    config = load_config(config_file, settings or (), calibration=calibration)
    known = load_prior_map(map_log)
    with console.progress_bar("looking", "optimising") as progress:
        summary = replay(
            source,
            output,
            config,
            topics=chosen,
            prior_map=known,
            initial_pose=prior,
            extend=False,
            progress=progress,
        )
    if picture is not None and summary.relocalization_times_s:
        draw_drive(output, picture, known)
    times_s, distances_m = summary.relocalization_times_s, summary.relocalization_distances_m
    found = {
        "output": str(output),
        "found": bool(times_s),
        "time_to_first_relocalization_s": times_s[0] if times_s else None,
        "distance_to_first_relocalization_m": distances_m[0] if distances_m else None,
        "relocalization_count": len(times_s),
        "relocalization_times_s": list(times_s),
        "keyframes": summary.counters.get("keyframes", 0),
        "keyframes_recognised": summary.counters.get("keyframes_recognised", 0),
        "relocalized_keyframe_ratio": _relocalized_keyframe_ratio(summary),
        "tracked_ratio": summary.tracked_ratio,
        "kidnappings_detected": summary.counters.get("kidnappings_detected", 0),
        "relocalizations_revoked": summary.counters.get("relocalizations_revoked", 0),
        "query_median_s": summary.loop_closure_median_s,
        "notes": list(summary.notes),
    }
    if json:
        console.show_json(found)
    else:
        _show(summary, output, picture if summary.relocalization_times_s else None)
    if not summary.relocalization_times_s:
        raise typer.Exit(1)


def _parsed_prior(near: str | None) -> InitialPose | None:
    import numpy as np

    from slam.place_recognition.initial_pose import InitialPose

    if near is None:
        return None
    try:
        x_m, y_m, *yaw_deg, sigma_m = (float(part) for part in near.split(","))
    except ValueError:
        x_m, y_m, yaw_deg, sigma_m = 0.0, 0.0, [], -1.0
    if len(yaw_deg) > 1 or not (sigma_m > 0.0 and np.isfinite([x_m, y_m, *yaw_deg, sigma_m]).all()):
        raise typer.BadParameter(
            f"{near!r} is not X,Y,SIGMA or X,Y,YAW,SIGMA in metres and degrees, as in 120,-35,90,10.",
            param_hint="--near",
        )
    yaw_rad = float(np.deg2rad(yaw_deg[0])) if yaw_deg else None
    return InitialPose(np.array([x_m, y_m]), sigma_m, yaw_rad=yaw_rad)


def _relocalized_keyframe_ratio(summary: ReplaySummary) -> float:
    return summary.counters.get("keyframes_recognised", 0) / max(summary.counters.get("keyframes", 0), 1)


def _show(summary: ReplaySummary, output: Path, picture: Path | None) -> None:
    from tools import console

    counters = summary.counters
    times_s, distances_m = summary.relocalization_times_s, summary.relocalization_distances_m
    rows = {
        "first fix": f"after {times_s[0]:.1f} s and {distances_m[0]:.1f} m"
        if times_s
        else "none: no place of the map was recognised",
        "later fixes": ", ".join(f"{time:.0f} s" for time in times_s[1:]) or "none",
        "recognised": f"{counters.get('keyframes_recognised', 0)} of {counters.get('keyframes', 0)} keyframes "
        f"({100 * _relocalized_keyframe_ratio(summary):.0f} %)",
        "tracked": f"{100 * summary.tracked_ratio:.0f} % of the online poses were in the map frame",
        "kidnapped": f"detected {counters.get('kidnappings_detected', 0)} times; "
        f"{counters.get('relocalizations_revoked', 0)} relocalizations revoked",
        "a query takes": f"{1e3 * summary.loop_closure_median_s:.1f} ms in the median",
        **({"of the log": "; ".join(summary.notes)} if summary.notes else {}),
        "final status": summary.final_status,
        "written": str(output) + (f", {picture}" if picture else ""),
    }
    console.show(console.pairs(rows))
