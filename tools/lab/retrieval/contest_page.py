"""A contest on a page: right poses of each proposer by query and map, its cost, and both over the size of the map."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from slam.display.map_picture import save_figure
from tools.lab.tables import UNDEFINED, number, percent, to_markdown

_GRID = "#e5e7eb"
_MAP = ["map_objects", "map_classes"]
_QUERY = ["objects", "missing", "clutter", "noise_m"]
_SCENARIO = ["map_classes", *_QUERY]


def to_page(cells: pd.DataFrame) -> str:
    """Tables in Markdown, two for each map: right poses after verification by query, and the cost of the first query.

    Args:
        cells: as :func:`tools.lab.retrieval.contest.run_contest` returns them.
    """
    parts = list[str]()
    for (world, objects, classes), of_map in cells.groupby(["world", *_MAP], sort=False):
        right = {
            (describe_query(*query), proposer): percent(rows["right"].iloc[0], 0)
            for (*query, proposer), rows in of_map.groupby([*_QUERY, "proposer"], sort=False)
        }
        proposers = of_map["proposer"].unique()
        queries = [
            {"query": query} | {proposer: right.get((query, proposer), UNDEFINED) for proposer in proposers}
            for query in dict.fromkeys(query for query, _ in right)
        ]
        costs = [_cost(row) for _, row in of_map.drop_duplicates("proposer").iterrows()]
        kinds = "1 class" if classes == 1 else f"{classes} classes"
        title = f"**{_names_of(world)}: {objects:,} objects of {kinds}**; right poses, %"
        parts += [title, "", to_markdown(queries), "", to_markdown(costs), ""]
    return "\n".join(parts).rstrip()


def _names_of(world: str) -> str:
    """The files of a world with their folders."""
    return ", ".join("/".join(Path(source).parts[-2:]) for source in world.split(" + "))


def _cost(cell: pd.Series) -> dict[str, str]:
    return {
        "": cell["proposer"],
        "places @1 / @5 / @25 %": " / ".join(percent(cell[f"at_{k}"], 0) for k in (1, 5, 25)),
        "accepted and wrong %": percent(cell["wrong"], 0),
        "propose ms (95 %)": f"{number(cell['propose_ms'], 1)} ({number(cell['propose_p95_ms'], 1)})",
        "verify ms": number(cell["verify_ms"], 1),
        "bytes an object": number(cell["bytes_per_object"], 0),
        "build s": number(cell["build_s"], 1),
    }


def describe_query(objects: int, missing: float, clutter: float, noise_m: float) -> str:
    """A scenario in a few words; 0 objects are those of 50 m."""
    seen = f"{objects} objects" if objects else "objects of 50 m"
    return f"{seen}, {missing:.0%} missing, {clutter:.0%} clutter, {noise_m:g} m"


def draw_contest(path_png: Path, cells: pd.DataFrame) -> None:
    """One column for each number of classes and scenario: above the right poses, below the time, over the size.

    Args:
        path_png: the picture.
        cells: as :func:`tools.lab.retrieval.contest.run_contest` returns them.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    groups = list(cells.groupby(_SCENARIO, sort=False))
    figure = Figure(figsize=(1.5 + 2.2 * len(groups), 6.0), layout="constrained", dpi=100)
    axes = figure.subplots(2, len(groups), sharex=True, sharey="row", squeeze=False)
    for column, (scenario, of_scenario) in enumerate(groups):
        above, below = axes[:, column]
        for proposer, rows in of_scenario.sort_values("map_objects").groupby("proposer", sort=False):
            above.plot(rows["map_objects"], 100.0 * rows["right"], marker="o", markersize=4, label=proposer)
            below.plot(rows["map_objects"], rows["propose_ms"], marker="o", markersize=4)
        above.set_title(_title(*scenario), fontsize=8)
        above.set_ylim(-3.0, 103.0)
        below.set_xscale("log")
        below.set_yscale("log")
        below.set_xlabel("objects of the map")
        for axis in (above, below):
            axis.grid(color=_GRID)
            axis.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_ylabel("right poses [%]")
    axes[1, 0].set_ylabel("time to propose [ms]")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    save_figure(figure, path_png)


def _title(classes: int, objects: int, missing: float, clutter: float, noise_m: float) -> str:
    kinds = "1 class" if classes == 1 else f"{classes} classes"
    seen, *others = describe_query(objects, missing, clutter, noise_m).split(", ")
    return f"{kinds}, {seen}\n{', '.join(others)}"
