"""dslam benchmark retrieval."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tools.arguments import ConfigFile, Json, Settings, Topics, parse_topics
from tools.lab.tables import Markdown, number, percent, report


def retrieval(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG.mcap...", help="Drives with truth.", show_default=False)],
    descriptor: Annotated[
        list[str] | None,
        typer.Option(
            "--descriptor",
            metavar="NAME",
            help="Descriptor: a name, a weights file or module:Class. Repeatable; by default all.",
        ),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Measure the recall of places by descriptors alone at each revisit of a drive.

    The drive is mapped without closing loops, and every descriptor gets the same submaps. Places: queries with a
    right pose (4 m, 10 deg) among the first 1, 5 and 25 proposals.

    Example: dslam benchmark retrieval drive.mcap --descriptor gosmatch_vertex --descriptor descriptellation_lr
    """
    from descriptors.registry import DESCRIPTOR_NAMES
    from slam.common.config import load_config
    from tools import console
    from tools.lab.retrieval.revisits import measure_revisits

    config = load_config(config_file, settings or ())
    names = descriptor or list(DESCRIPTOR_NAMES)
    figures: list[dict[str, Any]] = []
    for log in logs:
        with console.progress_bar(f"mapping {log.name}", "mapping") as move:
            figures += measure_revisits(
                log, names, config, topics=parse_topics(topics), on_progress=move or (lambda done: None)
            )
    report(
        [_row(each) for each in figures],
        texts=["descriptor"],
        markdown=markdown,
        json={"figures": figures} if json else None,
    )


def _row(figures: dict[str, Any]) -> dict[str, str]:
    from tools.lab.retrieval.labelled_map import RECALL_AT

    return {
        "drive": figures["drive"],
        "descriptor": figures["descriptor"],
        "queries": str(figures["queries"]),
        **{f"places @{k} %": percent(figures[f"places_at_{k}"]) for k in RECALL_AT},
        "query ms": number(figures["query_ms"], 1),
        "map s": number(figures["index_s"], 2),
    }
