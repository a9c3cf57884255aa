"""dslam benchmark retrieval."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings, Topics, parse_topics

if TYPE_CHECKING:
    from tools.lab.retrieval.measurement import RetrievalFigures

HEADINGS = (
    "queries",
    "places @1 %",
    "@5 %",
    "@25 %",
    "objects @1 %",
    "@5 %",
    "@25 %",
    "match ms",
    "verify ms",
    "map s",
)


def retrieval(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG.mcap...", help="Drives with truth.", show_default=False)],
    descriptor: Annotated[
        list[str] | None,
        typer.Option("--descriptor", metavar="NAME", help="Only these; weights or module:Class too. Repeatable."),
    ] = None,
    neighbours: Annotated[
        int | None,
        typer.Option(min=1, help="Matches of each object; by default loop_closure.top_k.", show_default=False),
    ] = None,
    spacing: Annotated[float, typer.Option(metavar="M", min=0.0, help="Least travel between two queries.")] = 4.75,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown.")] = False,
    json: Json = False,
) -> None:
    """Ask descriptors for the place at each revisit of a drive: nothing is followed or searched exhaustively.

    The drive is mapped without closing loops, and every descriptor is asked the same submaps. Places: queries with a
    right pose (4 m, 10 deg) among the first 1, 5 and 25 that the registration finds among the matches. Objects: those
    of the map whose counterpart is among their first 1, 5 and 25 matches.

    --set registration.method=ransac verifies by sampling.

    Example: dslam benchmark retrieval drive.mcap --descriptor ring_likelihood --descriptor descriptellation_lr
    """
    from dataclasses import asdict

    from descriptors.registry import DESCRIPTOR_NAMES
    from slam.common.config import load_config
    from tools import console
    from tools.lab.retrieval.measurement import measure_retrieval
    from tools.lab.retrieval.recorded_places import record_places

    config = load_config(config_file, settings or ())
    names = descriptor or list(DESCRIPTOR_NAMES)
    figures: list[RetrievalFigures] = []
    for log in logs:
        with console.progress_bar(f"mapping {log.name}", "mapping") as move:
            recorded = record_places(
                log, config, spacing_m=spacing, topics=parse_topics(topics), on_progress=move or (lambda done: None)
            )
        with console.progress_bar(f"asking at {log.name}", "asking") as move:
            figures += measure_retrieval(
                recorded, names, neighbours=neighbours, on_progress=move or (lambda done: None)
            )
    if json:
        console.show_json({"figures": [asdict(each) for each in figures]})
    elif markdown:
        headings = ["drive", "descriptor", *HEADINGS]
        lines = [headings, ["---"] * len(headings), *([each.drive, each.descriptor, *_row(each)] for each in figures)]
        console.show(*("| " + " | ".join(line) + " |" for line in lines))
    else:
        table = console.grid({"drive": False, "descriptor": False})
        for heading in HEADINGS:
            table.add_column(heading, justify="right")
        for each in figures:
            table.add_row(each.drive, each.descriptor, *_row(each))
        console.show(table)


def _row(figures: RetrievalFigures) -> list[str]:
    shares = [*figures.places.values(), *figures.objects.values()]
    times = [f"{figures.match_ms:.1f}", f"{figures.verify_ms:.1f}", f"{figures.index_s:.2f}"]
    return [str(figures.queries), *(f"{100.0 * share:.1f}" for share in shares), *times]
