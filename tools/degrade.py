"""dslam degrade."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import InputLog, Json, Topics, check_outputs, parse_topics

if TYPE_CHECKING:
    from slam.simulation.faults.fault import FaultCase
    from slam.simulation.faults.faulty_log import FaultSummary

_VIEW = "What the sensor sees"
_DETECTOR = "How well it detects"
_FAULTS = "Faults"


def _list_faults(wanted: bool) -> None:
    if wanted:
        from slam.simulation.faults.registry import FAULTS
        from tools import console

        console.show(console.pairs({fault.usage: fault.meaning for fault in FAULTS.values()}))
        raise typer.Exit


_FieldOfView = Annotated[
    str | None,
    typer.Option(metavar="DEG", help="Field of view, centred ahead, up to 360.", rich_help_panel=_VIEW),
]
_MaxRange = Annotated[
    str | None,
    typer.Option(metavar="M", help="Horizontal distance beyond which nothing is seen.", rich_help_panel=_VIEW),
]
_KeepLabel = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Keep only objects of this class. Repeatable.", rich_help_panel=_VIEW),
]
_Dropout = Annotated[
    str | None,
    typer.Option(metavar="P", help="Probability that a detection is lost.", rich_help_panel=_DETECTOR),
]
_LabelConfusion = Annotated[
    str | None,
    typer.Option(
        metavar="P", help="Probability that a detection gets another label of the log.", rich_help_panel=_DETECTOR
    ),
]
_PositionNoise = Annotated[
    str | None,
    typer.Option(metavar="M", help="Standard deviation of the position on each axis.", rich_help_panel=_DETECTOR),
]
_FaultNames = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME[=VALUE]",
        help="Apply this fault; its values are joined by colons. Repeatable.",
        rich_help_panel=_FAULTS,
    ),
]
_ListFaults = Annotated[
    bool,
    typer.Option(
        "--list-faults",
        help="List the faults with their values and their meaning.",
        callback=_list_faults,
        is_eager=True,
        rich_help_panel=_FAULTS,
    ),
]
_Seed = Annotated[int, typer.Option(help="Seed of the random numbers.")]


def degrade(
    source: InputLog,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="The log to write.")],
    field_of_view: _FieldOfView = None,
    max_range: _MaxRange = None,
    keep_label: _KeepLabel = None,
    dropout: _Dropout = None,
    label_confusion: _LabelConfusion = None,
    position_noise: _PositionNoise = None,
    fault: _FaultNames = None,
    _listed: _ListFaults = False,
    seed: _Seed = 0,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Degrade a log: missed, wrong or false detections, more drift of the odometry, faults of the sensors.

    Options are applied in a fixed order: noise, dropout, view and labels, label confusion; then --fault, in
    the given order. Each has its own random numbers. The ground truth does not change. Give at least one option, for
    example --dropout 0.

    Example: dslam degrade drive.mcap -o harder.mcap --dropout 0.3 --fault false_positives=2
    """
    options = {
        "position_noise": position_noise,
        "dropout": dropout,
        "field_of_view": field_of_view,
        "max_range": max_range,
        "keep_label": ":".join(keep_label) if keep_label else None,
        "label_confusion": label_confusion,
    }
    faults = [f"{name}={value}" for name, value in options.items() if value is not None] + (fault or [])
    if not faults:
        raise typer.BadParameter("no degradation was given; give one, for example --dropout 0.3")
    chosen = parse_topics(topics)
    check_outputs([output], [source])
    from slam.simulation.faults.faulty_log import write_faulty
    from slam.simulation.faults.registry import parse_faults
    from tools import console

    cases = parse_faults(faults)
    with console.progress_bar("degrading", "finishing") as progress:
        summary = write_faulty(source, output, cases, seed=seed, topics=chosen, progress=progress)
    if json:
        console.show_json(
            {
                "output": str(output),
                "seed": seed,
                "faults": [case.name for case in cases],
                "detections_before": summary.detections_before,
                "detections": summary.detections,
                "message_counts": summary.message_counts,
                "left_out": summary.left_out,
            }
        )
    else:
        _show(output, seed, cases, summary)


def _show(output: Path, seed: int, cases: list[FaultCase], summary: FaultSummary) -> None:
    from tools import console

    rows = {
        "faults": "\n".join(f"{case.name}: {case.fault.meaning}" for case in cases),
        "detections": f"{summary.detections} after, {summary.detections_before} before",
        "warnings": ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in summary.left_out.items()) or "none",
        "written": f"{output} (seed {seed})",
    }
    console.show(console.pairs(rows))
