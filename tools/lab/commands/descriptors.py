"""dslam benchmark descriptors, and map-size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json, check_outputs
from tools.lab.commands.map_tiles import measure_tiles

if TYPE_CHECKING:
    from slam.simulation.world import World
    from tools.lab.descriptors.experiment import Cell, DescriptorBenchmark
    from tools.lab.descriptors.map_size import SizeCell

HEADINGS = ("success %", "of ceiling %", "ceiling %", "misplaced %", "likeliest %", "top 5 %", "ms")


Objects = Annotated[
    Path | None, typer.Option(metavar="CSV", help="Objects of a map: x_m,y_m,z_m,class,id.", show_default=False)
]
Trajectory = Annotated[
    Path | None, typer.Option(metavar="CSV", help="Where queries are drawn: x_m,y_m.", show_default=False)
]
Methods = Annotated[
    list[str] | None,
    typer.Option(
        "--descriptor", metavar="NAME", help="Only these; 'exhaustive search' and 'as shipped', too. Repeatable."
    ),
]
Neighbours = Annotated[int, typer.Option(min=1, help="Nearest descriptors of each object; loop_closure.top_k.")]


def descriptors(
    objects: Objects = None,
    trajectory: Trajectory = None,
    descriptor: Methods = None,
    neighbours: Neighbours = 6,
    queries: Annotated[int, typer.Option(min=1, help="For each scenario and seed.")] = 500,
    seeds: Annotated[int, typer.Option(min=1, help="How often, each time with other queries.")] = 5,
    registration: Annotated[
        str, typer.Option(metavar="vote|ransac", help="How matches propose poses; see registration.method.")
    ] = "vote",
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown.")] = False,
    json: Json = False,
) -> None:
    """Localize queries in a map of objects with each descriptor, as in the Descriptellation paper.

    From random poses on the trajectory the objects within 30 m are seen, hidden ones aside (self); within 20 m (fewer
    objects); or with the paper's noise (added noise). Verification and acceptance are those of a replay. Success is
    a pose that is accepted and less than 1 m off, misplaced one that is accepted and more than 10 m off, likeliest
    the likeliest candidate less than 1 m off, accepted or not. The ceiling is that of a weighted fit to the true
    correspondences; top 5 the share of objects whose counterpart is among their five nearest. 'as shipped' retrieves
    by triangles and the default descriptor, and searches exhaustively where these find nothing.
    Without CSV files the map is a simulated street of 1150 m with 795 objects of 25 classes.

    Example: dslam benchmark descriptors --descriptor descriptellation_lr --descriptor onion --queries 100 --seeds 1
    """
    from dataclasses import asdict

    from descriptors.registry import DESCRIPTOR_NAMES
    from tools import console
    from tools.lab.descriptors.experiment import AS_SHIPPED, EXHAUSTIVE, benchmark_descriptors
    from tools.lab.descriptors.queries import labelled_map

    if registration not in ("vote", "ransac"):
        raise typer.BadParameter(f"{registration!r} is neither vote nor ransac.", param_hint="--registration")
    world = _world(objects, trajectory)
    methods = descriptor or [*DESCRIPTOR_NAMES, EXHAUSTIVE, AS_SHIPPED]
    with console.progress_bar("localizing", "localizing") as move:
        result = benchmark_descriptors(
            labelled_map(world),
            world.tour,
            methods,
            neighbours=neighbours,
            queries=queries,
            seeds=seeds,
            registration=registration,
            on_progress=_counted(move, 3 * len(methods)),
        )
    if json:
        console.show_json({"map": world.name, **asdict(result)})
    elif markdown:
        console.show(*_markdown(world.name, result))
    else:
        _show(world.name, result)


def _world(objects: Path | None, trajectory: Path | None) -> World:
    """The map of the files, or a simulated street."""
    import numpy as np

    from slam.simulation.street import generate_street
    from slam.simulation.world import load_world

    if (objects is None) != (trajectory is None):
        raise typer.BadParameter("--objects and --trajectory belong together; give both or neither.")
    if objects is not None and trajectory is not None:
        return load_world(objects, trajectory)
    return generate_street(rng=np.random.default_rng(0))


def _counted(move: Callable[[float], None] | None, total: int) -> Callable[[object], None]:
    """Moves a progress bar, if there is one, by one of ``total`` steps at each call."""
    steps = count(1)

    def step(_: object) -> None:
        if move is not None:
            move(next(steps) / total)

    return step


def map_size(
    objects: Annotated[Path, typer.Option(metavar="CSV", help="Objects of a map: x_m,y_m,z_m,class,id.")],
    trajectory: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV", help="Its first 500 m are driven: x_m,y_m. Without it, maps of tiles.", show_default=False
        ),
    ] = None,
    descriptor: Annotated[
        list[str] | None,
        typer.Option(
            "--descriptor", metavar="NAME", help="These instead of the default and exhaustive search. Repeatable."
        ),
    ] = None,
    size: Annotated[
        list[int] | None, typer.Option("--size", metavar="N", min=1, help="Objects in the map. Repeatable.")
    ] = None,
    neighbours: Neighbours = 6,
    queries: Annotated[int, typer.Option(min=1, help="For each scenario.")] = 100,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="PNG", help="Draw success and time over size.")
    ] = None,
    json: Json = False,
) -> None:
    """Localize the same queries in ever larger maps, with a descriptor and by exhaustive search.

    Maps larger than the one given add altered copies of it. Sizes are 500 to 50,000 objects if none is said.

    Without a trajectory a kidnapped robot drives 50 m anywhere, and is to be found in maps of tiles of the nearest
    10,000 and of all objects; what these take to make and to open is measured as well.

    Example: dslam benchmark map-size --objects objects.csv --trajectory trajectory.csv --size 500 --size 2000
    """
    from dataclasses import asdict

    from slam.common.config import LoopClosureConfig
    from slam.simulation.world import load_world
    from tools import console
    from tools.lab.descriptors.experiment import EXHAUSTIVE
    from tools.lab.descriptors.map_size import SIZES, benchmark_map_size
    from tools.lab.descriptors.map_size_picture import draw_map_size

    check_outputs([picture], [objects, trajectory])
    if trajectory is None:
        if descriptor or picture is not None:
            raise typer.BadParameter("--descriptor and --picture need --trajectory.", param_hint="--trajectory")
        measure_tiles(objects, size or (), queries=queries, json=json)
        return
    methods = descriptor or [LoopClosureConfig().descriptor, EXHAUSTIVE]
    sizes = sorted(size or SIZES)
    with console.progress_bar("localizing", "localizing") as move:
        cells = benchmark_map_size(
            load_world(objects, trajectory),
            methods,
            sizes=sizes,
            queries=queries,
            neighbours=neighbours,
            on_progress=_counted(move, 3 * len(methods) * len(sizes)),
        )
    if picture is not None:
        draw_map_size(picture, cells)
    if json:
        console.show_json({"cells": [asdict(cell) for cell in cells]})
    else:
        _show_sizes(cells)


def _show_sizes(cells: Sequence[SizeCell]) -> None:
    from tools import console

    headings = ("objects", "within 1 m %", "median ms", "p95 ms", "map s")
    table = console.grid({"descriptor": False, "scenario": False, **dict.fromkeys(headings, True)})
    for cell in cells:
        table.add_row(
            cell.method,
            cell.scenario,
            str(cell.objects),
            f"{100 * cell.success:.0f}",
            f"{cell.median_ms:.1f}",
            f"{cell.p95_ms:.1f}",
            f"{cell.build_s:.2f}",
        )
    console.show(table)


def _row(cell: Cell) -> list[str]:
    return [
        f"{100 * cell.success:.1f} ± {100 * cell.deviation:.1f}",
        "-" if cell.of_ceiling is None else f"{100 * cell.of_ceiling:.1f}",
        f"{100 * cell.ceiling:.1f}",
        f"{100 * cell.misplaced:.1f}",
        f"{100 * cell.likeliest:.1f}",
        "-" if cell.top_5 is None else f"{100 * cell.top_5:.1f}",
        f"{cell.query_ms:.1f}",
    ]


def _title(name: str, result: DescriptorBenchmark) -> str:
    return (
        f"{name}: {result.objects} objects, {result.classes} classes; {result.queries} queries x {result.seeds} seeds, "
        f"{result.neighbours} nearest descriptors"
    )


def _show(name: str, result: DescriptorBenchmark) -> None:
    from tools import console

    table = console.grid(
        {"descriptor": False, "scenario": False, **dict.fromkeys(HEADINGS, True)}, title=_title(name, result)
    )
    for cell in result.cells:
        table.add_row(cell.method, cell.scenario, *_row(cell))
    built = ", ".join(f"{method} {seconds:.2f} s" for method, seconds in result.build_s.items())
    console.show(table, f"taking in the map: {built}")


def _markdown(name: str, result: DescriptorBenchmark) -> list[str]:
    rows = [[cell.method, cell.scenario, *_row(cell)] for cell in result.cells]
    headings = ["descriptor", "scenario", *HEADINGS]
    lines = [headings, ["---"] * len(headings), *rows]
    return [_title(name, result), "", *("| " + " | ".join(line) + " |" for line in lines)]
