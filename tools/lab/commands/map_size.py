"""dslam benchmark map-size."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json
from tools.lab.tables import number, percent, show

if TYPE_CHECKING:
    from tools.lab.retrieval.map_tiles import TilesCell

SIZES = (10_000, 1_000_000)


def map_size(
    objects: Annotated[Path, typer.Option(metavar="CSV", help="Objects of a map: x_m,y_m,z_m,class.")],
    size: Annotated[
        list[int] | None, typer.Option("--size", metavar="N", min=1, help="Objects in the map. Repeatable.")
    ] = None,
    queries: Annotated[int, typer.Option(min=1, help="In each map.")] = 100,
    json: Json = False,
) -> None:
    """Search for a robot that drove 50 m anywhere in ever larger maps, by their index and exhaustively.

    Maps have the objects nearest to one of them, 10,000 and all if no size is given. Times to make, open and query a
    map, and its memory, are measured, too.

    Example: dslam benchmark map-size --objects objects.csv --size 10000 --size 100000
    """
    from dataclasses import asdict

    from logs.importers.maps.object_table import read_object_table
    from tools import console
    from tools.lab.retrieval.map_tiles import benchmark_tiles

    sizes = size or SIZES
    with console.progress_line("measuring") as progress:

        def report(done: int) -> None:
            if progress is not None:
                progress(done / (2 * len(sizes)), f"{done} of {2 * len(sizes)}")

        cells = benchmark_tiles(read_object_table(objects), sizes, queries=queries, on_progress=report)
    if json:
        console.show_json({"cells": [asdict(cell) for cell in cells]})
    else:
        show([_row(cell) for cell in cells], "All times are of the processor.")


def _row(cell: TilesCell) -> dict[str, str]:
    return {
        "method": cell.method,
        "objects": str(cell.objects),
        "make s": number(cell.make_s, 1),
        "make MB": number(cell.make_mb, 0),
        "file MB": number(cell.file_mb, 0),
        "open s": number(cell.open_s, 3),
        "queries": str(cell.queries),
        "right %": percent(cell.success),
        "median ms": number(cell.median_ms, 1),
        "p95 ms": number(cell.p95_ms, 1),
    }
