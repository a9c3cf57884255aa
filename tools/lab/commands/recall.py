"""dslam benchmark recall."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import Json
from tools.lab.tables import Descriptors, Markdown, report, row_of

if TYPE_CHECKING:
    from tools.lab.retrieval.path_queries import Scenario

RESULTS = "contest.csv"
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
    objects: Annotated[
        list[Path],
        typer.Option(metavar="CSV", help="Objects: x_m,y_m,z_m,class. Repeatable: side by side."),
    ],
    descriptor: Descriptors = None,
    size: Annotated[
        list[int] | None,
        typer.Option(min=1, metavar="N", help="Size of the map: the N objects nearest to a random one. Repeatable."),
    ] = None,
    classes: Annotated[
        list[int] | None,
        typer.Option(min=1, metavar="N", help="The N - 1 commonest classes, and one for all others. Repeatable."),
    ] = None,
    missing: Annotated[
        list[float] | None,
        typer.Option(
            min=0.0, max=0.9, metavar="S", help="Share of the objects in range that is not detected. Repeatable."
        ),
    ] = None,
    clutter: Annotated[
        list[float] | None,
        typer.Option(min=0.0, max=0.9, metavar="S", help="Share of the detected objects that is clutter. Repeatable."),
    ] = None,
    noise: Annotated[
        list[float] | None,
        typer.Option(min=0.0, metavar="M", help="Standard deviation of each coordinate of a query. Repeatable."),
    ] = None,
    sensor_range: Annotated[
        list[float] | None,
        typer.Option("--range", min=1.0, metavar="M", help="Range of the sensor. Repeatable."),
    ] = None,
    seen: Annotated[
        list[int] | None,
        typer.Option(
            min=3, metavar="N", help="Objects of a query; by default all in range on a path of 5/3 ranges. Repeatable."
        ),
    ] = None,
    queries: Annotated[int, typer.Option(min=1, help="Queries in each map and scenario.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the place, the thinning and the queries.")] = 0,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="Folder of a CSV file, to which the measurements are added.",
        ),
    ] = None,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Compare descriptors: recall of places in a map of objects.

    By default a query holds the objects within 30 m, the range of the sensor, of a path of 50 m; a tenth of them is
    missing, a tenth of the query is clutter, and positions have 0.2 m of noise. If several values of these options are
    given, one option is varied at a time, with the first value of all others. Places: queries with a right pose (4 m,
    10 deg) among the first 1, 5 and 25 proposals; right: after verification; wrong: accepted and wrong. Random vectors
    are always measured, with the first values. Times are processor times.

    Example: dslam benchmark recall --objects trees.csv --size 10000 --size 50000 --descriptor descriptellation_lr
    """
    from descriptors.random_vector import RandomVector
    from descriptors.registry import DESCRIPTOR_NAMES
    from logs.importers.maps.object_table import read_object_table
    from tools import console
    from tools.lab.retrieval.contest import Contest, run_contest, scenario_of, side_by_side

    proposers = dict.fromkeys([*(descriptor or DESCRIPTOR_NAMES), RandomVector.name])
    contest = Contest(
        proposers=tuple(proposers),
        sizes=tuple(size or [10_000]),
        classes=tuple(classes or [20]),
        scenarios=_scenarios(missing or [0.1], clutter or [0.1], noise or [0.2], seen or [0], sensor_range or [30.0]),
        queries=queries,
        seed=seed,
    )
    world = side_by_side([read_object_table(path) for path in objects])
    with console.progress_bar("measuring") as move:
        cells = run_contest(world, contest, on_progress=move)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        path = output / RESULTS
        cells.to_csv(path, mode="a", header=not path.exists(), index=False, lineterminator="\n")
    found = cells.to_dict("records")
    report(
        [row_of(COLUMNS, {**each, "query": scenario_of(each).describe(contest.scenarios[0])}) for each in found],
        texts=("map", "query"),
        markdown=markdown,
        json={"figures": found} if json else None,
    )


def _scenarios(
    missing: Sequence[float],
    clutter: Sequence[float],
    noise_m: Sequence[float],
    objects: Sequence[int],
    range_m: Sequence[float],
) -> tuple[Scenario, ...]:
    """The first values of all, and each other one of them beside the first of the others."""
    from dataclasses import replace

    from tools.lab.retrieval.path_queries import Scenario

    varied: dict[str, Sequence[Any]] = {"missing": missing, "clutter": clutter, "noise_m": noise_m, "objects": objects}
    varied["range_m"] = range_m
    first = Scenario(**{name: values[0] for name, values in varied.items()})
    return (first, *(replace(first, **{name: each}) for name, values in varied.items() for each in values[1:]))
