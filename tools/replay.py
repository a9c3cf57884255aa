"""dslam replay."""

from __future__ import annotations

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
_LANDMARK_STATES = ("confirmed", "tentative", "retired")


def replay(
    source: InputLog,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="The log to write.")],
    config_file: ConfigFile = None,
    calibration: CalibrationFile = None,
    settings: Settings = None,
    topics: Topics = None,
    map_log: Annotated[
        Path | None,
        typer.Option(
            "--map", metavar="MAP.mcap", help="Localize the robot in this map, and extend the map.", show_default=False
        ),
    ] = None,
    save_map: Annotated[
        Path | None,
        typer.Option("--save-map", metavar="MAP.mcap", help="Save the map for later drives.", show_default=False),
    ] = None,
    online: Annotated[
        bool,
        typer.Option("--online", help="Calibrate the robot during the drive, from past records only."),
    ] = False,
    copy: Annotated[
        list[str] | None,
        typer.Option("--copy", metavar="/TOPIC", help="Also copy this topic, for example of a camera. Repeatable."),
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

    config = load_config(config_file, settings or (), calibration=calibration)
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
    written = [str(path) for path in (output, save_map, picture) if path is not None]
    if json:
        console.show_json({"output": str(output), **asdict(summary), "real_time_factor": _real_time_factor(summary)})
    else:
        _show(written, summary)


def _show(written: list[str], summary: ReplaySummary) -> None:
    from tools import console

    counters = summary.counters
    landmarks = [f"{counters.get(f'landmarks_{state}', 0)} {state}" for state in _LANDMARK_STATES]
    real_time_factor = _real_time_factor(summary)
    speed = f", {real_time_factor:.1f} x real time" if real_time_factor else ""
    rows = {
        "log": f"{summary.log_s:.1f} s, mapped in {summary.wall_s:.1f} s{speed}",
        "used": f"{counters.get('odometry_used', 0)} odometry messages, {counters.get('detections_used', 0)} scans "
        f"with {counters.get('objects_used', 0)} objects",
        "keyframes": _keyframes(counters),
        "landmarks": ", ".join(landmarks),
        "loops": f"{counters.get('closures_accepted', 0)} loop closures accepted ({_origins(counters)}), "
        f"{counters.get('closures_inserted', 0)} factors, {counters.get('closures_removed', 0)} removed as outliers"
        + rejected_by_odometry_note(counters.get("closures_rejected_by_odometry", 0)),
        **({"found": _fixes(summary)} if summary.relocalization_times_s else {}),
        "warnings": ", ".join(noted_counters(counters)) or "none",
        **({"of the log": "; ".join(summary.notes)} if summary.notes else {}),
        "trajectory": str(summary.trajectory_check),
        "final status": summary.final_status,
        "written": ", ".join(written),
    }
    console.show(console.pairs(rows))


def _keyframes(counters: Mapping[str, int]) -> str:
    condensed = counters.get("keyframes_condensed", 0)
    return str(counters.get("keyframes", 0)) + (f", {condensed} condensed into earlier ones" if condensed else "")


def noted_counters(counters: Mapping[str, int]) -> list[str]:
    """Warnings for the user: the nonzero counters of records that were left out or corrected."""
    return [
        f"{name.replace('_', ' ')} {count}"
        for name, count in counters.items()
        if count and not name.startswith(_SHOWN) and name not in _USED
    ]


def _origins(counters: Mapping[str, int]) -> str:
    """The propagated closures are only as right as the retrieved ones that they start from."""
    retrieved = counters.get("closures_retrieved", 0)
    return f"{retrieved} retrieved, {counters.get('closures_accepted', 0) - retrieved} propagated"


def _fixes(summary: ReplaySummary) -> str:
    """Time and travel of each relocalization, since the start of the drive."""
    fixes = zip(summary.relocalization_times_s, summary.relocalization_distances_m, strict=True)
    return ", ".join(f"at {seconds:.1f} s, {travel_m:.0f} m from the start" for seconds, travel_m in fixes)


def rejected_by_odometry_note(count: int) -> str:
    """A large number means that the odometry drifts more than it is configured to."""
    if not count:
        return ""
    return f"; {count} more rejected by the odometry penalty (calibration.odometry.yaw_sigma, translation_sigma)"


def _real_time_factor(summary: ReplaySummary) -> float | None:
    return summary.log_s / summary.wall_s if summary.wall_s > 0.0 else None
