"""Options that several commands share."""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from slam.common.georeference import Georeference

InputLog = Annotated[Path, typer.Argument(metavar="LOG", help="MCAP file, or ROS 2 bag (folder or file).")]
Output = Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="The log to write.")]
NewLog = Annotated[Path, typer.Argument(metavar="OUT.mcap", help="The log to write.")]
SlamLog = Annotated[Path, typer.Argument(metavar="OUT.mcap", help="A log that 'dslam replay' wrote.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
ConfigFile = Annotated[Path | None, typer.Option("--config", metavar="FILE.toml", help="Read settings from a file.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one setting; overrides the file. Repeatable."),
]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="ROBOT.toml",
        help="The robot's calibration, as 'dslam calibrate' writes it; else it is estimated from the log.",
    ),
]
Jobs = Annotated[int | None, typer.Option(min=1, help="Processes. \\[default: one per core]")]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic", metavar="KIND=/TOPIC", help="Use this topic as odometry, detections, ground_truth, ... Repeatable."
    ),
]


def can_draw(path: Path | None) -> Path | None:
    """The path of a picture; if its library is missing or it is named as another format, the command ends before any
    work is done.
    """
    if path is not None:
        import matplotlib  # noqa: F401

        if path.suffix.lower() != ".png":
            raise typer.BadParameter(f"{path} does not end with .png, the format that is written.")
    return path


Picture = Annotated[
    Path | None, typer.Option("--picture", metavar="PNG", help="Draw the map from above.", callback=can_draw)
]


def parse_topics(pairs: Sequence[str] | None) -> dict[str, str]:
    """kind -> topic, from "kind=/topic"; several of one kind separated by commas."""
    topics: dict[str, str] = {}
    for pair in pairs or ():
        kind, _, topic = pair.partition("=")
        if not kind or not topic:
            raise typer.BadParameter(f"{pair!r} is not KIND=/TOPIC, for example odometry=/odom.", param_hint="--topic")
        topics[kind] = f"{topics[kind]},{topic}" if kind in topics else topic
    return topics


def parse_origin(text: str) -> "Georeference":
    """The place on earth that "LAT,LON[,ALT[,YAW]]" names, degrees and metres."""
    from slam.common.georeference import Georeference

    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if not (2 <= len(numbers) <= 4 and all(map(math.isfinite, numbers))):
        raise typer.BadParameter(
            f"{text!r} is not LAT,LON[,ALT[,YAW]], for example 60.17,24.94.", param_hint="--origin"
        )
    latitude, longitude, altitude_m, yaw_deg = [*numbers, 0.0, 0.0][:4]
    return Georeference(latitude, longitude, altitude_m, math.radians(yaw_deg))


def check_outputs(outputs: Sequence[Path | None], inputs: Sequence[Path | None]) -> None:
    """Refuse an output that is an input or another output, or whose folder is missing, before any work is done.

    Outputs are written as NAME.part first, which is therefore taken too.
    """
    from logs.errors import UnwritableLogError
    from logs.storage.placement import check_replaceable, partial_path

    taken: set[str] = set()
    for output in filter(None, outputs):
        check_replaceable(output)
        paths = {os.path.realpath(output), os.path.realpath(partial_path(output))}
        if paths & taken:
            raise UnwritableLogError(f"{output} is given for two outputs (or NAME and NAME.part); give other paths")
        taken |= paths
        if not output.parent.is_dir():
            raise UnwritableLogError(f"cannot write {output}: there is no folder {output.parent}; make it first")
        for written in (output, partial_path(output)):
            if any(path and path.exists() and written.exists() and written.samefile(path) for path in inputs):
                raise UnwritableLogError(f"{written} is the input; give another path for the output")
