"""dslam relocalize."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, InputLog, Json, Settings, Topics, check_outputs, parse_topics

if TYPE_CHECKING:
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
) -> None:
    """Find a robot in a saved map, and follow it there; the map stays as it is.

    Poses are on /slam/pose from the first fix on, each recognised keyframe with its covariance is on
    /slam/relocalizations, and what happened is on /slam/status. Exits 1 if the robot was never found.

    Example: dslam relocalize tuesday.mcap --map monday_map.mcap -o tuesday_found.mcap
    """
    chosen = parse_topics(topics)
    check_outputs([output], [source, config_file, map_log])
    from slam.config import load_config
    from slam.replay import replay
    from slam.saved_map import load_map
    from tools import console

    config = load_config(config_file, settings or ())
    known = load_map(map_log)
    with console.progress_bar("looking", "optimising") as progress:
        summary = replay(source, output, config, topics=chosen, earlier=known, extend=False, progress=progress)
    found = {
        "output": str(output),
        "found": bool(summary.fixes_s),
        "first_fix_s": summary.fixes_s[0] if summary.fixes_s else None,
        "first_fix_m": summary.fixes_m[0] if summary.fixes_m else None,
        "fixes": len(summary.fixes_s),
        "keyframes": summary.counters.get("keyframes", 0),
        "keyframes_recognised": summary.counters.get("keyframes_recognised", 0),
        "kidnappings_noticed": summary.counters.get("kidnappings_noticed", 0),
        "relocalizations_taken_back": summary.counters.get("relocalizations_taken_back", 0),
        "query_median_s": summary.closing_median_s,
    }
    if json:
        console.show_json(found)
    else:
        _show(summary, output)
    if not summary.fixes_s:
        raise typer.Exit(NOT_FOUND)


def _show(summary: ReplaySummary, output: Path) -> None:
    from tools import console

    counters = summary.counters
    keyframes = counters.get("keyframes", 0)
    recognised = counters.get("keyframes_recognised", 0)
    rows = {
        "first fix": f"after {summary.fixes_s[0]:.1f} s and {summary.fixes_m[0]:.1f} m"
        if summary.fixes_s
        else "none: the map was not recognised",
        "later fixes": ", ".join(f"{time:.0f} s" for time in summary.fixes_s[1:]) or "none",
        "recognised": f"{recognised} of {keyframes} keyframes ({100 * recognised / max(keyframes, 1):.0f} %)",
        "carried off": f"noticed {counters.get('kidnappings_noticed', 0)} times; "
        f"{counters.get('relocalizations_taken_back', 0)} fixes taken back",
        "a query takes": f"{1e3 * summary.closing_median_s:.1f} ms in the median",
        "final status": summary.final_status,
        "written": str(output),
    }
    console.show(console.pairs(rows))
