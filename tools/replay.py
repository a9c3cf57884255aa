"""dslam replay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Json, Picture, Settings, Topics, check_outputs, parse_topics

if TYPE_CHECKING:
    from slam.replay import ReplaySummary

# Everything else that is counted was used, or is a number of landmarks.
_USED = ("odometry_used", "detections_used", "objects_used", "keyframes", "keyframes_recognised", "batch_iterations")
_TOLD = ("landmarks_", "closures_", "relocalizations")
_LANDMARK_STATES = ("confirmed", "tentative", "retired")


def replay(
    source: InputLog,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="The log to write.")],
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    map_log: Annotated[
        Path | None,
        typer.Option(
            "--map", metavar="MAP.mcap", help="Find the robot in that map, and go on from it.", show_default=False
        ),
    ] = None,
    save_map: Annotated[
        Path | None,
        typer.Option("--save-map", metavar="MAP.mcap", help="Save the map for later drives.", show_default=False),
    ] = None,
    json: Json = False,
    picture: Picture = None,
) -> None:
    """Map a log: odometry and detections in, trajectory and object map out.

    Example: dslam replay drive.mcap -o map.mcap --set keyframe.distance_m=1.5
    """
    chosen = parse_topics(topics)
    check_outputs([output, picture, save_map], [source, config_file, map_log])
    from slam.common.config import load_config
    from slam.object_map.map_io import load_map
    from slam.replay import replay as replay_log
    from tools import console

    config = load_config(config_file, settings or ())
    earlier = load_map(map_log) if map_log is not None else None
    with console.progress_bar("mapping", "optimising everything at once") as progress:
        summary = replay_log(
            source, output, config, topics=chosen, earlier=earlier, map_path=save_map, progress=progress
        )
    if picture is not None:
        _draw(output, picture)
    if json:
        console.show_json({"output": str(output), **asdict(summary), "x_real_time": _x_real_time(summary)})
    else:
        _show(output, picture, summary)


def _draw(output: Path, picture: Path) -> None:
    from slam.evaluation.evaluate import evaluate
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.report.picture import compose_picture
    from slam.visualization.map_plot import draw_map

    records = read_records(output)
    draw_map(picture, compose_picture(records, evaluate(records), title=output.stem))


def _show(output: Path, picture: Path | None, summary: ReplaySummary) -> None:
    from tools import console

    counters = summary.counters
    landmarks = [f"{counters.get(f'landmarks_{state}', 0)} {state}" for state in _LANDMARK_STATES]
    x_real_time = _x_real_time(summary)
    speed = f", {x_real_time:.1f} x real time" if x_real_time else ""
    rows = {
        "log": f"{summary.log_s:.1f} s, mapped in {summary.wall_s:.1f} s{speed}",
        "used": f"{counters.get('odometry_used', 0)} odometry messages, {counters.get('detections_used', 0)} scans "
        f"with {counters.get('objects_used', 0)} objects",
        "keyframes": str(counters.get("keyframes", 0)),
        "landmarks": ", ".join(landmarks),
        "loops": f"closed at {counters.get('closures_accepted', 0)} keyframes, "
        f"by {counters.get('closures_inserted', 0)} factors; {counters.get('closures_withdrawn', 0)} taken out again"
        + doubted_note(counters.get("closures_doubted", 0)),
        **({"found": _fixes(summary)} if summary.fixes_s else {}),
        "warnings": ", ".join(noted_counters(counters)) or "none",
        "final status": summary.final_status,
        "written": str(output) + (f", {picture}" if picture else ""),
    }
    console.show(console.pairs(rows))


def noted_counters(counters: Mapping[str, int]) -> list[str]:
    """What a user is warned of: the counters, other than zeros, of what was not simply used."""
    return [
        f"{name.replace('_', ' ')} {count}"
        for name, count in counters.items()
        if count and not name.startswith(_TOLD) and name not in _USED
    ]


def _fixes(summary: ReplaySummary) -> str:
    """When a robot that was lost knew again where it is."""
    fixes = zip(summary.fixes_s, summary.fixes_m, strict=True)
    return ", ".join(f"after {seconds:.1f} s and {travel_m:.0f} m" for seconds, travel_m in fixes)


def doubted_note(count: int) -> str:
    """Many of them mean that the odometry drifts more than the configuration says."""
    if not count:
        return ""
    return f"; {count} more look like a loop, but odometry.yaw_sigma and translation_sigma do not allow it"


def _x_real_time(summary: ReplaySummary) -> float | None:
    return summary.log_s / summary.wall_s if summary.wall_s > 0.0 else None
