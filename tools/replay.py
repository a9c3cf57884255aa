"""dslam replay."""

from collections import Counter
from collections.abc import Mapping
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

if TYPE_CHECKING:
    from slam.replay import ReplaySummary

# Everything else that is counted was used, or is a number of landmarks.
_USED = (
    "odometry_used",
    "detections_used",
    "objects_used",
    "keyframes",
    "keyframes_recognised",
    "keyframes_condensed",
    "batch_iterations",
    "calibrations",
)
_SHOWN = ("landmarks_", "closures_", "relocalizations")


def replay(
    source: InputLog,
    output: Output,
    config_file: ConfigFile = None,
    calibration: CalibrationFile = None,
    settings: Settings = None,
    topics: Topics = None,
    map_log: Annotated[
        Path | None,
        typer.Option("--map", metavar="MAP.mcap", help="Localize the robot in this map, and extend the map."),
    ] = None,
    save_map: Annotated[Path | None, typer.Option(metavar="MAP.mcap", help="Save the map for later drives.")] = None,
    online: Annotated[
        bool, typer.Option("--online", help="Calibrate the robot during the drive, from past records only.")
    ] = False,
    copy: Annotated[
        list[str] | None,
        typer.Option(metavar="/TOPIC", help="Also copy this topic, for example of a camera. Repeatable."),
    ] = None,
    json: Json = False,
    picture: Picture = None,
) -> None:
    """Map a log: odometry and detections in, trajectory and object map out.

    Example: dslam replay drive.mcap -o map.mcap --set keyframe.distance_m=1.5
    """
    chosen = parse_topics(topics)
    check_outputs([output, picture, save_map], [source, config_file, calibration, map_log])
    from slam.common.config import load_config
    from slam.localization.prior_map import load_prior_map
    from slam.replay import replay as replay_log
    from tools import console

    config = load_config(config_file, settings, calibration=calibration)
    prior_map = load_prior_map(map_log) if map_log is not None else None
    with console.progress_bar("mapping", "optimising everything at once") as progress:
        summary = replay_log(
            source,
            output,
            config,
            topics=chosen,
            prior_map=prior_map,
            online=online,
            map_path=save_map,
            copy=copy or (),
            progress=progress,
        )
    if picture is not None:
        draw_drive(output, picture)
    if json:
        console.show_json({"output": str(output), **asdict(summary)})
        return
    console.show(
        console.pairs(describe(summary) | {"written": ", ".join(map(str, filter(None, (output, save_map, picture))))})
    )


def describe(summary: "ReplaySummary") -> dict[str, str]:
    """How a replay went, for people."""
    counters = Counter(summary.counters)
    condensed = counters["keyframes_condensed"]
    retrieved, accepted = counters["closures_retrieved"], counters["closures_accepted"]
    fixes = zip(summary.relocalization_times_s, summary.relocalization_distances_m, strict=True)
    speed = f", {summary.log_s / summary.wall_s:.1f} x real time" if summary.wall_s > 0.0 else ""
    # The propagated closures are only as right as the retrieved ones that they start from.
    rows = {
        "log": f"{summary.log_s:.1f} s, mapped in {summary.wall_s:.1f} s{speed}",
        "used": f"{counters['odometry_used']} odometry messages, {counters['detections_used']} scans "
        f"with {counters['objects_used']} objects",
        "keyframes": f"{counters['keyframes']}" + (f", {condensed} condensed into earlier ones" if condensed else ""),
        "landmarks": f"{counters['landmarks_confirmed']} confirmed, {counters['landmarks_tentative']} tentative, "
        f"{counters['landmarks_retired']} retired",
        "loops": f"{accepted} loop closures accepted ({retrieved} retrieved, {accepted - retrieved} propagated), "
        f"{counters['closures_inserted']} factors",
        "found": ", ".join(f"at {seconds:.1f} s, {travel_m:.0f} m from the start" for seconds, travel_m in fixes),
        "warnings": "; ".join([*noted_counters(counters), *summary.notes]) or "none",
        "trajectory": str(summary.trajectory_check),
        "final status": summary.final_status,
    }
    return {name: text for name, text in rows.items() if text}


def noted_counters(counters: Mapping[str, int]) -> list[str]:
    """Warnings for the user: the nonzero counters of records that were left out or corrected."""
    return [
        f"{name.replace('_', ' ')} {count}"
        for name, count in counters.items()
        if count and not name.startswith(_SHOWN) and name not in _USED
    ]
