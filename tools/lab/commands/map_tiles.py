"""dslam benchmark map-size without a trajectory: maps of tiles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

SIZES = (10_000, 1_000_000)


def measure_tiles(objects: Path, sizes: Sequence[int], *, queries: int, json: bool) -> None:
    """Measure maps of so many objects of a table, and print what they take."""
    from dataclasses import asdict

    from logs.importers.maps.object_table import read_object_table
    from tools import console
    from tools.lab.retrieval.map_tiles import benchmark_tiles

    asked = sizes or SIZES
    with console.progress_line("measuring") as progress:

        def report(done: int) -> None:
            if progress is not None:
                progress(done / (2 * len(asked)), f"{done} of {2 * len(asked)}")

        cells = benchmark_tiles(read_object_table(objects), asked, queries=queries, on_progress=report)
    if json:
        console.show_json({"cells": [asdict(cell) for cell in cells]})
        return
    headings = ("objects", "make s", "make MB", "file MB", "open s", "queries", "right %", "median ms", "p95 ms")
    table = console.grid({"method": False, **dict.fromkeys(headings, True)})
    for cell in cells:
        table.add_row(
            cell.method,
            str(cell.objects),
            f"{cell.make_s:.1f}",
            f"{cell.make_mb:.0f}",
            f"{cell.file_mb:.0f}",
            f"{cell.open_s:.3f}",
            str(cell.queries),
            f"{100 * cell.success:.1f}",
            f"{cell.median_ms:.1f}",
            f"{cell.p95_ms:.1f}",
        )
    console.show(table, "All times are of the processor.")
