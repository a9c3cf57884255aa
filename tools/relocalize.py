"""dslam relocalize."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Json, Picture, Settings, Topics, check_outputs, parse_topics

if TYPE_CHECKING:
    from slam.object_map.map_io import SavedMap
    from slam.replay import ReplaySummary

NOT_FOUND = 1


def relocalize(
    source: InputLog,
    map_log: Annotated[Path, typer.Option("--map", metavar="MAP.mcap", help="The map to find the robot in.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="The log to write.")],
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    json: Json = False,
    picture: Picture = None,
) -> None:
    """Find a robot in a saved map, and follow it there; the map stays as it is.

    Poses are on /slam/pose from the first fix on, each recognised keyframe with its covariance is on
    /slam/relocalizations, and what happened is on /slam/status. Exits 1 if the robot was never found.

    Example: dslam relocalize tuesday.mcap --map monday_map.mcap -o tuesday_found.mcap
    """
    chosen = parse_topics(topics)
    check_outputs([output, picture], [source, config_file, map_log])
    from slam.common.config import load_config
    from slam.object_map.map_io import load_map
    from slam.replay import replay
    from tools import console

    config = load_config(config_file, settings or ())
    known = load_map(map_log)
    with console.progress_bar("looking", "optimising") as progress:
        summary = replay(source, output, config, topics=chosen, earlier=known, extend=False, progress=progress)
    if picture is not None and summary.fixes_s:
        _draw(output, picture, known)
    found = {
        "output": str(output),
        "found": bool(summary.fixes_s),
        "first_fix_s": summary.fixes_s[0] if summary.fixes_s else None,
        "first_fix_m": summary.fixes_m[0] if summary.fixes_m else None,
        "fixes": len(summary.fixes_s),
        "fixes_s": list(summary.fixes_s),
        "keyframes": summary.counters.get("keyframes", 0),
        "keyframes_recognised": summary.counters.get("keyframes_recognised", 0),
        "recognised_share": _recognised_share(summary),
        "tracked_share": summary.tracked_share,
        "kidnappings_noticed": summary.counters.get("kidnappings_noticed", 0),
        "relocalizations_taken_back": summary.counters.get("relocalizations_taken_back", 0),
        "query_median_s": summary.closing_median_s,
    }
    if json:
        console.show_json(found)
    else:
        _show(summary, output, picture if summary.fixes_s else None)
    if not summary.fixes_s:
        raise typer.Exit(NOT_FOUND)


def _draw(output: Path, picture: Path, known: SavedMap) -> None:
    """The path over the landmarks of the map; those of the drive alone are left out."""
    from dataclasses import replace

    from slam.evaluation.evaluate import evaluate
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.report.picture import compose_picture
    from slam.visualization.map_plot import draw_map

    records = read_records(output)
    whole = compose_picture(records, evaluate(records), title=output.stem)
    draw_map(picture, replace(whole, landmarks=known.objects.positions[:0], labels=(), known=known.objects.positions))


def _recognised_share(summary: ReplaySummary) -> float:
    return summary.counters.get("keyframes_recognised", 0) / max(summary.counters.get("keyframes", 0), 1)


def _show(summary: ReplaySummary, output: Path, picture: Path | None) -> None:
    from tools import console

    counters = summary.counters
    rows = {
        "first fix": f"after {summary.fixes_s[0]:.1f} s and {summary.fixes_m[0]:.1f} m"
        if summary.fixes_s
        else "none: the map was not recognised",
        "later fixes": ", ".join(f"{time:.0f} s" for time in summary.fixes_s[1:]) or "none",
        "recognised": f"{counters.get('keyframes_recognised', 0)} of {counters.get('keyframes', 0)} keyframes "
        f"({100 * _recognised_share(summary):.0f} %)",
        "tracked": f"{100 * summary.tracked_share:.0f} % of the poses were known in the map when they came",
        "carried off": f"noticed {counters.get('kidnappings_noticed', 0)} times; "
        f"{counters.get('relocalizations_taken_back', 0)} fixes taken back",
        "a query takes": f"{1e3 * summary.closing_median_s:.1f} ms in the median",
        "final status": summary.final_status,
        "written": str(output) + (f", {picture}" if picture else ""),
    }
    console.show(console.pairs(rows))
