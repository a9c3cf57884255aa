"""dslam benchmark relocalization."""

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings, Topics, parse_topics
from tools.lab.tables import report

COLUMNS = {
    "where": "{where}",
    "drives": "{kidnaps}",
    "found": "{success_rate:.1%}",
    "late": "{late_rate:.1%}",
    "wrong": "{false_relocalization_rate:.1%}",
    "lost": "{not_found_rate:.1%}",
    "m": "{median_distance_m:.1f}",
    "95 %": "{p95_distance_m:.1f}",
    "s": "{median_seconds:.1f}",
    "off m": "{median_error_m:.2f}",
    "95 % off": "{p95_error_m:.2f}",
    "deg": "{median_error_deg:.2f}",
    "search ms": "{query_ms:.1f}",
}


def relocalization(
    log: Annotated[Path, typer.Option(metavar="LOG.mcap", help="A drive with its truth.")],
    map_until: Annotated[
        float | None, typer.Option(metavar="SECONDS", min=1.0, help="Map the drive up to this time.")
    ] = None,
    map_log: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="MAP.mcap",
            help="Do not map the drive, but use this imported map, in the frame of the truth.",
        ),
    ] = None,
    kidnaps: Annotated[
        int, typer.Option(min=1, help="Largest number of places in the map, and of places outside.")
    ] = 100,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Put a robot down at places of a drive, and measure how soon it is relocalized in a map.

    The first part of the drive is mapped, or a map is given. The robot starts at places of the rest of the drive,
    evenly spread, and drives 60 m: half of them in the map, where it must be found, half outside, where it must not.

    Found: a fix within 40 m with an error below 4 m and 10 deg in the map; late: a right fix after 40 m; wrong: any
    other fix; lost: no fix. Distance and time are medians of right fixes, errors are of all fixes.

    Example: dslam benchmark relocalization --log kitti00.mcap --map-until 311 --kidnaps 40

    Example: dslam benchmark relocalization --log helsinki.mcap --map helsinki_map.mcap
    """
    from slam.common.config import load_config
    from slam.localization.prior_map import load_prior_map
    from slam.place_recognition.imported_map import ImportedMap
    from tools.lab.relocalization.kidnappings import benchmark_relocalization

    if (map_until is None) == (map_log is None):
        raise typer.BadParameter("give one of them.", param_hint="--map-until and --map")
    config = load_config(config_file, settings)
    given = map_until if map_log is None else load_prior_map(map_log)
    if not isinstance(given, ImportedMap | float):
        raise typer.BadParameter("this map was made by a drive; give that drive and --map-until.", param_hint="--map")
    result = benchmark_relocalization(log, config, given=given, kidnaps=kidnaps, topics=parse_topics(topics))
    elsewhere = [each["is_right"] is not None for each in result["elsewhere"]]
    report(
        [{"where": "everywhere", **result["everywhere"]}],
        "found, late, wrong and lost: per cent of the drives",
        f"outside the map: {sum(elsewhere)} false fixes in {len(elsewhere)} drives",
        columns=COLUMNS,
        title=f"{result['drive']}: {result['landmarks']} landmarks, map ATE {result['map_ate_m']:.2f} m",
        json=result if json else None,
    )
