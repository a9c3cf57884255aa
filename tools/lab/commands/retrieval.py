"""dslam benchmark retrieval."""

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings, Topics, parse_topics
from tools.lab.tables import Descriptors, Markdown, compared_descriptors, report

COLUMNS = {
    "drive": "{drive}",
    "descriptor": "{descriptor}",
    "queries": "{queries}",
    "places @1 %": "{places_at_1:.1%}",
    "places @5 %": "{places_at_5:.1%}",
    "places @25 %": "{places_at_25:.1%}",
    "query ms": "{query_ms:.1f}",
    "map s": "{index_s:.2f}",
}


def retrieval(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG.mcap...", help="Drives with truth.")],
    descriptor: Descriptors = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Measure the recall of places by descriptors alone at each revisit of a drive.

    The drive is mapped without closing loops, and every descriptor gets the same submaps. Places: queries with a
    right pose (4 m, 10 deg) among the first 1, 5 and 25 proposals.

    Random vectors are always measured.

    Example: dslam benchmark retrieval drive.mcap --descriptor gosmatch_vertex --descriptor descriptellation_lr
    """
    from slam.common.config import load_config
    from tools.lab.retrieval.revisits import measure_revisits

    config = load_config(config_file, settings)
    names = compared_descriptors(descriptor)
    figures = [row for log in logs for row in measure_revisits(log, names, config, topics=parse_topics(topics))]
    report(
        figures, columns=COLUMNS, texts=["descriptor"], markdown=markdown, json={"figures": figures} if json else None
    )
