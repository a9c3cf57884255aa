"""dslam calibrate."""

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings, Topics, check_outputs, parse_topics


def calibrate(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs of one robot; their data are pooled.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="ROBOT.toml", help="The calibration to write.")
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Estimate noise, scales and faults of a robot's sensors from its logs, for 'dslam replay --calibration'.

    A correction is made only if it predicts held-out parts of the logs, and better than any other explanation does.

    Example: dslam calibrate monday.mcap tuesday.mcap -o robot.toml
    """
    chosen = parse_topics(topics)
    check_outputs([output], [*logs, config_file])
    from slam.common.config import load_config
    from slam.common.config_tree import to_toml
    from slam.prepared_log import calibrate_logs
    from tools import console

    found = calibrate_logs(logs, load_config(config_file, settings), topics=chosen)
    calibration = found.config.calibration
    if output is not None:
        output.write_text(to_toml(calibration), encoding="utf-8")
    if json:
        estimated = sorted(found.estimated)
        console.show_json({"calibration": calibration, "estimated": estimated, "notes": found.notes})
        return
    rows = {}
    for key, value in sorted(found.estimated.items()):
        sigma = calibration.sigmas.get(key)
        rows[key] = f"{value:.4g}" + ("" if sigma is None else f" +- {sigma:.2g}")
    rows["from"] = ", ".join(f"{name} {value:.0f}" for name, value in calibration.evidence.items())
    rows |= {"notes": "; ".join(found.notes), "written": str(output or "")}
    console.show(console.pairs({name: text for name, text in rows.items() if text}))
