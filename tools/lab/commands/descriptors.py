"""dslam benchmark descriptors."""

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json
from tools.lab.tables import Descriptors, Markdown, compared_descriptors, report

COLUMNS = {
    "descriptor": "{method}",
    "scenario": "{scenario}",
    "success %": "{success:.1%} ± {deviation:.1%}",
    "misplaced %": "{misplaced:.1%}",
    "likeliest %": "{likeliest:.1%}",
    "ms": "{query_ms:.1f}",
    "map s": "{build_s:.2f}",
}


def descriptors(
    objects: Annotated[Path | None, typer.Option(metavar="CSV", help="Objects of a map: x_m,y_m,z_m,class,id.")] = None,
    trajectory: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Path along which queries are sampled: x_m,y_m.")
    ] = None,
    descriptor: Descriptors = None,
    queries: Annotated[int, typer.Option(min=1, help="Queries for each scenario and seed.")] = 500,
    seeds: Annotated[int, typer.Option(min=1, help="Repetitions, each with different queries.")] = 5,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Localize queries in a map of objects with each descriptor, as in the Descriptellation paper.

    Queries hold the visible objects within 30 m of random poses on the trajectory (self), within 20 m (fewer objects),
    or with the paper's noise (added noise). Verification and acceptance are those of a replay. Success: accepted, error
    below 1 m. Misplaced: accepted, error above 10 m. Likeliest: the likeliest candidate, accepted or not, has an error
    below 1 m. Without CSV files the map is the generated town of 'dslam simulate --seed 0'. Random vectors are always
    measured.

    Example: dslam benchmark descriptors --descriptor descriptellation_lr --descriptor gosmatch_vertex --queries 100
    """
    from tools.lab.retrieval.labelled_map import labelled_map
    from tools.lab.retrieval.paper import benchmark_descriptors
    from tools.simulate import load_or_generate

    world = load_or_generate(objects, trajectory, seed=0)
    objects_of_map = labelled_map(world)
    cells = benchmark_descriptors(
        objects_of_map, world.tour, compared_descriptors(descriptor), queries=queries, seeds=seeds
    )
    rows = cells.to_dict("records")
    numbers = {"objects": len(objects_of_map), "classes": len(objects_of_map.vocabulary)}
    about = {"map": world.name, **numbers, "queries": queries, "seeds": seeds}
    report(
        rows,
        columns=COLUMNS,
        title="{map}: {objects} objects, {classes} classes; {queries} queries x {seeds} seeds".format_map(about),
        texts=["scenario"],
        markdown=markdown,
        json={**about, "cells": rows} if json else None,
    )
