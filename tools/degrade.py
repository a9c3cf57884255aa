"""dslam degrade."""

from dataclasses import asdict
from typing import Annotated

import typer

from tools.arguments import InputLog, Json, Output, Topics, check_outputs, parse_topics


def _list_faults(wanted: bool) -> None:
    if wanted:
        from slam.simulation.faults.registry import FAULTS
        from tools import console

        console.show(console.pairs({fault.name: fault.meaning for fault in FAULTS.values()}))
        raise typer.Exit


def degrade(
    source: InputLog,
    output: Output,
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[=VALUE]", help="Apply this fault; its values are joined by colons. Repeatable."),
    ] = None,
    _listed: Annotated[
        bool,
        typer.Option(
            "--list-faults",
            help="List the faults with their values and their meaning.",
            callback=_list_faults,
            is_eager=True,
        ),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Degrade a log: missed, wrong or false detections, more drift of the odometry, faults of the sensors.

    Faults are applied in the given order, and each has its own random numbers. The ground truth does not change.

    Example: dslam degrade drive.mcap -o harder.mcap --fault dropout=0.3 --fault false_positives=2
    """
    if not fault:
        raise typer.BadParameter("no fault was given; give one, for example --fault dropout=0.3")
    chosen = parse_topics(topics)
    check_outputs([output], [source])
    from slam.simulation.faults.faulty_log import write_faulty
    from slam.simulation.faults.registry import parse_faults
    from tools import console

    faults = parse_faults(fault)
    with console.progress_bar("degrading", "finishing") as progress:
        summary = write_faulty(source, output, faults, seed=seed, topics=chosen, progress=progress)
    applied = [each.name for each in faults]
    console.report({"output": output, "seed": seed, "faults": applied, **asdict(summary)}, as_json=json)
