"""dslam benchmark recall."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json
from tools.lab.tables import number, percent, show, to_markdown

if TYPE_CHECKING:
    from tools.lab.retrieval.object_maps import MapRecall


def recall(
    objects: Annotated[Path, typer.Option(metavar="CSV", help="Objects: x_m,y_m,z_m,class.", show_default=False)],
    descriptor: Annotated[
        list[str] | None,
        typer.Option("--descriptor", metavar="NAME", help="Only these; weights or module:Class too. Repeatable."),
    ] = None,
    size: Annotated[
        list[int] | None, typer.Option(min=1, metavar="N", help="Objects nearest to one of them. Repeatable.")
    ] = None,
    share: Annotated[
        list[float] | None, typer.Option(min=1e-3, max=1.0, metavar="S", help="Of the objects that stay. Repeatable.")
    ] = None,
    classes: Annotated[
        list[int] | None,
        typer.Option(min=1, metavar="N", help="The commonest of them, and one for all others. Repeatable."),
    ] = None,
    queries: Annotated[int, typer.Option(min=1, help="In each map.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Of the place, the thinning and the queries.")] = 0,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown.")] = False,
    json: Json = False,
) -> None:
    """Ask descriptors for the place in maps of objects, by their number, density and classes.

    A robot has driven 50 m anywhere; it misses a tenth of the objects within 30 m, a tenth of what it has is clutter,
    and positions have 0.2 m of noise. Places: queries with a right pose (4 m, 10 deg) among the first 1, 5 and 25 that
    the registration finds among the matches. Times are of the processor.

    Example: dslam benchmark recall --objects trees.csv --size 10000 --size 50000 --descriptor descriptellation_lr
    """
    from dataclasses import asdict

    from descriptors.registry import DESCRIPTOR_NAMES
    from logs.importers.maps.object_table import read_object_table
    from tools import console
    from tools.lab.retrieval.object_maps import measure_recall

    names = descriptor or list(DESCRIPTOR_NAMES)
    sizes, shares, counts = size or [10_000], share or [1.0], classes or [20]
    total = len(names) * len(sizes) * len(shares) * len(counts)
    with console.progress_line("measuring") as progress:

        def report(done: int) -> None:
            if progress is not None:
                progress(done / total, f"{done} of {total}")

        figures = measure_recall(
            read_object_table(objects),
            names,
            sizes=sizes,
            shares=shares,
            classes=counts,
            queries=queries,
            seed=seed,
            on_progress=report,
        )
    if json:
        console.show_json({"figures": [asdict(each) for each in figures]})
    elif markdown:
        typer.echo(to_markdown([_row(each) for each in figures]))
    else:
        show([_row(each) for each in figures])


def _row(figures: MapRecall) -> dict[str, str]:
    return {
        "descriptor": figures.descriptor,
        "objects": str(figures.objects),
        "neighbours": number(figures.neighbours, 1),
        "classes": str(figures.classes),
        "queries": str(figures.queries),
        **{f"places @{k} %": percent(share) for k, share in figures.places.items()},
        "map s": number(figures.index_s, 1),
        "match ms": number(figures.match_ms, 1),
        "verify ms": number(figures.verify_ms, 1),
    }
