"""dslam benchmark recall."""

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json
from tools.lab.tables import Descriptors, Markdown, compared_descriptors, report

COLUMNS = {
    "descriptor": "{proposer}",
    "map": "{map_objects} of {map_classes}",
    "query": "{query}",
    "@1 %": "{at_1:.1%}",
    "@5 %": "{at_5:.1%}",
    "@25 %": "{at_25:.1%}",
    "right %": "{right:.1%}",
    "wrong %": "{wrong:.1%}",
    "ms": "{propose_ms:.1f}",
    "95 % ms": "{propose_p95_ms:.1f}",
    "verify ms": "{verify_ms:.1f}",
    "B/object": "{bytes_per_object:.0f}",
    "build s": "{build_s:.1f}",
}


def recall(
    objects: Annotated[Path, typer.Option(metavar="CSV", help="Objects: x_m,y_m,z_m,class.")],
    descriptor: Descriptors = None,
    size: Annotated[
        list[int] | None,
        typer.Option(min=1, metavar="N", help="Size of the map: the N objects nearest to a random one. Repeatable."),
    ] = None,
    classes: Annotated[
        list[int] | None,
        typer.Option(min=1, metavar="N", help="The N - 1 commonest classes, and one for all others. Repeatable."),
    ] = None,
    query: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=NUMBER,...",
            help="What differs from the usual query: objects, missing, clutter, noise_m, range_m. Repeatable.",
        ),
    ] = None,
    queries: Annotated[int, typer.Option(min=1, help="Queries in each map and scenario.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the place, the thinning and the queries.")] = 0,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Compare descriptors: recall of places in a map of objects.

    A query holds the objects within 30 m, the range of the sensor, of a path of 50 m, or as many objects as given; a
    tenth of them is missing, a tenth of the query is clutter, and positions have 0.2 m of noise. Places: queries with a
    right pose (4 m, 10 deg) among the first 1, 5 and 25 proposals; right: after verification; wrong: accepted and
    wrong. Random vectors are always measured, with the first query. Times are processor times.

    Example: dslam benchmark recall --objects trees.csv --size 10000 --size 50000 --descriptor descriptellation_lr
    """
    from logs.importers.maps.object_table import read_object_table
    from tools.lab.retrieval.contest import run_contest

    world = read_object_table(objects).in_metres()
    cells = run_contest(
        world,
        compared_descriptors(descriptor),
        sizes=size or [10_000],
        classes=classes or [20],
        scenarios=query or [""],
        queries=queries,
        seed=seed,
    )
    found = cells.to_dict("records")
    report(found, columns=COLUMNS, texts=("map", "query"), markdown=markdown, json={"figures": found} if json else None)
