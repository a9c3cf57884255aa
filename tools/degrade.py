"""dslam degrade."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import InputLog, Json, Topics, check_outputs, parse_topics

if TYPE_CHECKING:
    from slam.simulation.degradation import DegradationConfig
    from slam.simulation.degraded_log import DegradationSummary
    from slam.simulation.faults.faulty_log import FaultSummary
    from slam.simulation.faults.registry import FaultCase

_VIEW = "What the sensor sees"
_DETECTOR = "How well it detects"
_DRIVE = "Odometry and time"
_FAULTS = "Faults"


def _list_faults(wanted: bool) -> None:
    if wanted:
        from slam.simulation.faults.registry import FAULTS
        from tools import console

        console.show(console.pairs({fault.usage: fault.meaning for fault in FAULTS.values()}))
        raise typer.Exit


_FieldOfView = Annotated[
    float | None,
    typer.Option(metavar="DEG", help="Angle of view about straight ahead, up to 360.", rich_help_panel=_VIEW),
]
_MaxRange = Annotated[
    float | None,
    typer.Option(metavar="M", help="Horizontal distance beyond which nothing is seen.", rich_help_panel=_VIEW),
]
_KeepLabel = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Keep only objects of that class. Repeatable.", rich_help_panel=_VIEW),
]
_DropLabel = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Take out objects of that class. Repeatable.", rich_help_panel=_VIEW),
]
_Dropout = Annotated[
    float | None,
    typer.Option(metavar="P", help="Probability that a detection is lost.", rich_help_panel=_DETECTOR),
]
_LabelConfusion = Annotated[
    float | None,
    typer.Option(metavar="P", help="Probability that it gets another of the log's labels.", rich_help_panel=_DETECTOR),
]
_PositionNoise = Annotated[
    float | None,
    typer.Option(metavar="M", help="Noise of the position on each axis, 1 sigma.", rich_help_panel=_DETECTOR),
]
_FalsePositives = Annotated[
    float | None,
    typer.Option(metavar="N", help="Mean number of invented objects a scan.", rich_help_panel=_DETECTOR),
]
_OdometryTranslationNoise = Annotated[
    float | None,
    typer.Option(metavar="M/SQRT(M)", help="On each axis, after 1 m of travel.", rich_help_panel=_DRIVE),
]
_OdometryYawNoise = Annotated[
    float | None,
    typer.Option(metavar="RAD/SQRT(M)", help="Of the heading, after 1 m of travel.", rich_help_panel=_DRIVE),
]
_TimeOffset = Annotated[
    float | None,
    typer.Option(metavar="S", help="Added to the detections' stamps, may be negative.", rich_help_panel=_DRIVE),
]
_Reversed = Annotated[
    bool, typer.Option("--reversed", help="Play the drive backwards, in reverse gear.", rich_help_panel=_DRIVE)
]
_FaultNames = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME[=VALUE]",
        help="Put that fault into the log, several values joined by a colon. Repeatable.",
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
_Seed = Annotated[int, typer.Option(help="Seed of all that is random.")]


def degrade(
    source: InputLog,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="The log to write.")],
    field_of_view: _FieldOfView = None,
    max_range: _MaxRange = None,
    keep_label: _KeepLabel = None,
    drop_label: _DropLabel = None,
    dropout: _Dropout = None,
    label_confusion: _LabelConfusion = None,
    position_noise: _PositionNoise = None,
    false_positives: _FalsePositives = None,
    odometry_translation_noise: _OdometryTranslationNoise = None,
    odometry_yaw_noise: _OdometryYawNoise = None,
    time_offset: _TimeOffset = None,
    is_reversed: _Reversed = False,
    fault: _FaultNames = None,
    _listed: _ListFaults = False,
    seed: _Seed = 0,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Make a log harder to map: detections lost, wrong or invented, odometry that drifts more, a drive backwards.

    Whatever the order of the options: the drive is reversed and times are
    shifted, then come view and labels, dropout, confusion, noise, and false
    positives, which lie where most detections in view do and have their heights
    and labels. Each has random numbers of its own. The truth stays as it is. At
    least one option has to be given, if only --dropout 0. Faults are put in after
    all that, in their order.

    Example: dslam degrade drive.mcap -o harder.mcap --dropout 0.3 --position-noise 0.2
    """
    options: dict[str, object] = {
        "field_of_view_deg": field_of_view,
        "max_range_m": max_range,
        "keep_labels": tuple(keep_label) if keep_label else None,
        "drop_labels": tuple(drop_label) if drop_label else None,
        "dropout": dropout,
        "label_confusion": label_confusion,
        "position_noise_m": position_noise,
        "false_positives": false_positives,
        "odometry_translation_noise": odometry_translation_noise,
        "odometry_yaw_noise": odometry_yaw_noise,
        "time_offset_s": time_offset,
        "reversed": is_reversed or None,
    }
    given = {name: value for name, value in options.items() if value is not None}
    if not given and not fault:
        raise typer.BadParameter("nothing to do; say how to degrade the log, for example by --dropout 0.3")
    chosen = parse_topics(topics)
    check_outputs([output], [source])
    from slam.simulation.degradation import make_degradation
    from slam.simulation.faults.registry import parse_faults

    config, cases = make_degradation(given), parse_faults(fault or ())
    summary, faulty = _write(source, output, config, cases, seed, chosen)
    if json:
        _show_json(output, seed, config, summary, cases, faulty)
        return
    if summary is not None:
        _show(output, seed, summary)
    if faulty is not None:
        _show_faults(output, seed, cases, faulty)


def _write(
    source: Path,
    output: Path,
    config: DegradationConfig,
    cases: list[FaultCase],
    seed: int,
    topics: dict[str, str],
) -> tuple[DegradationSummary | None, FaultSummary | None]:
    """Degrade, put faults in, or the one and then the other by way of a temporary log."""
    from tempfile import TemporaryDirectory

    from slam.simulation.degraded_log import write_degraded
    from slam.simulation.faults.faulty_log import write_faulty
    from tools import console

    summary = faulty = None
    with TemporaryDirectory() as folder, console.progress_bar("degrading", "finishing") as progress:
        if config.in_effect() or not cases:
            degraded = Path(folder) / "degraded.mcap" if cases else output
            summary = write_degraded(
                source, degraded, config, seed=seed, topics=topics, progress=None if cases else progress
            )
            source = degraded
        if cases:
            faulty = write_faulty(source, output, cases, seed=seed, topics=topics, progress=progress)
    return summary, faulty


def _show_json(
    output: Path,
    seed: int,
    config: DegradationConfig,
    summary: DegradationSummary | None,
    cases: list[FaultCase],
    faulty: FaultSummary | None,
) -> None:
    from tools import console

    written = faulty or summary  # of both, the faults wrote the output
    console.show_json(
        {
            "output": str(output),
            "seed": seed,
            "options": config.in_effect(),
            **(summary.counts if summary is not None else {}),
            **({"faults": [case.name for case in cases]} if faulty is not None else {}),
            "message_counts": written.message_counts if written is not None else {},
            "left_out": {**(summary.left_out if summary else {}), **(faulty.left_out if faulty else {})},
        }
    )


def _show_faults(output: Path, seed: int, cases: list[FaultCase], summary: FaultSummary) -> None:
    from tools import console

    told = [f"{case.name}: {case.fault.meaning}" for case in cases]
    rows = {
        "faults": "\n".join(told),
        "warnings": ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in summary.left_out.items()) or "none",
        "written": f"{output} (seed {seed})",
    }
    console.show(console.pairs(rows))


def _show(output: Path, seed: int, summary: DegradationSummary) -> None:
    from tools import console

    counts = summary.counts
    lost = {"out of view": "out_of_view", "of an unwanted class": "unwanted_label", "dropped out": "dropped_out"}
    losses = [f"{counts[name]} {how}" for how, name in lost.items() if counts[name]]
    rows = {
        "kept": f"{counts['kept']} of {counts['detections']} detections",
        "lost": ", ".join(losses) or "none",
        "relabelled": str(counts["relabelled"]),
        "false positives": str(counts["false_positives"]),
        "warnings": ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in summary.left_out.items()) or "none",
        "written": f"{output} (seed {seed})",
    }
    console.show(console.pairs(rows))
