"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

InputLog = Annotated[Path, typer.Argument(metavar="LOG.mcap", help="The log to read.", show_default=False)]
NewLog = Annotated[Path, typer.Argument(metavar="OUT.mcap", help="The log to write.", show_default=False)]
SlamLog = Annotated[
    Path, typer.Argument(metavar="OUT.mcap", help="A log that 'dslam replay' wrote.", show_default=False)
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", metavar="FILE.toml", help="Read settings from a file.", show_default=False)
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one setting; wins over the file. Repeatable."),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic", metavar="KIND=/TOPIC", help="Use that topic as odometry, detections, ground_truth, ... Repeatable."
    ),
]
Picture = Annotated[
    Path | None, typer.Option("--picture", metavar="PNG", help="Draw the map from above.", show_default=False)
]


def parse_topics(pairs: Sequence[str] | None) -> dict[str, str]:
    """kind -> topic, from "kind=/topic"."""
    topics: dict[str, str] = {}
    for pair in pairs or ():
        kind, equals, topic = pair.partition("=")
        if not equals or not kind or not topic:
            raise typer.BadParameter(f"{pair!r} is not KIND=/TOPIC, for example odometry=/odom.", param_hint="--topic")
        topics[kind] = topic
    return topics


def check_outputs(outputs: Sequence[Path | None], inputs: Sequence[Path | None] = ()) -> None:
    """Refuse an output that is an input or another output, or whose folder is missing, before any work is done."""
    from logs.errors import UnwritableLogError

    named = [output for output in outputs if output is not None]
    for output in named:
        if sum(output.resolve() == other.resolve() for other in named) > 1:
            raise UnwritableLogError(f"{output} is given for two outputs; give each a path of its own")
        if output.is_dir():
            raise UnwritableLogError(f"{output} is a folder; give the name of a file to write")
        if not output.parent.is_dir():
            raise UnwritableLogError(f"cannot write {output}: there is no folder {output.parent}; make it first")
        if any(path is not None and path.exists() and output.exists() and output.samefile(path) for path in inputs):
            raise UnwritableLogError(f"{output} is the input; give another path for the output")
