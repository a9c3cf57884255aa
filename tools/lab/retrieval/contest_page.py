"""A contest on a page: right poses of each proposer by query and map, its cost, and both over the size of the map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from slam.display.map_picture import save_figure
from tools.lab.retrieval.contest import scenario_of
from tools.lab.retrieval.labelled_map import RECALL_AT
from tools.lab.tables import number, percent, to_markdown


def to_page(cells: pd.DataFrame) -> str:
    """Tables in Markdown, two for each map: right poses after verification by query, and the cost of the first query.

    Args:
        cells: as :func:`tools.lab.retrieval.contest.run_contest` returns them.
    """
    parts = list[str]()
    for (world, objects, classes), of_map in cells.groupby(["world", "map_objects", "map_classes"], sort=False):
        queries = dict[str, dict[str, str]]()
        for cell in of_map.to_dict("records"):
            query = scenario_of(cell).describe()
            row = queries.setdefault(query, {"query": query, **dict.fromkeys(of_map["proposer"], percent(None))})
            row[cell["proposer"]] = percent(cell["right"], 0)
        costs = [_cost(cell) for cell in of_map.drop_duplicates("proposer").to_dict("records")]
        kinds = "1 class" if classes == 1 else f"{classes} classes"
        files = ", ".join("/".join(Path(source).parts[-2:]) for source in world.split(" + "))
        title = f"**{files}: {objects:,} objects of {kinds}**; right poses, %"
        parts += [title, "", to_markdown(list(queries.values())), "", to_markdown(costs), ""]
    return "\n".join(parts).rstrip()


def _cost(cell: dict[str, Any]) -> dict[str, str]:
    return {
        "": cell["proposer"],
        "places @1 / @5 / @25 %": " / ".join(percent(cell[f"at_{k}"], 0) for k in RECALL_AT),
        "accepted and wrong %": percent(cell["wrong"], 0),
        "propose ms (95 %)": f"{number(cell['propose_ms'], 1)} ({number(cell['propose_p95_ms'], 1)})",
        "verify ms": number(cell["verify_ms"], 1),
        "bytes an object": number(cell["bytes_per_object"], 0),
        "build s": number(cell["build_s"], 1),
    }


def draw_contest(path_png: Path, cells: pd.DataFrame) -> None:
    """One column for each number of classes and query: above the right poses, below the time, over the size.

    Args:
        path_png: the picture.
        cells: as :func:`tools.lab.retrieval.contest.run_contest` returns them.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    columns = list(cells.groupby(["map_classes", "objects", "missing", "clutter", "noise_m"], sort=False))
    figure = Figure(figsize=(1.5 + 2.2 * len(columns), 6.0), layout="constrained", dpi=100)
    axes = figure.subplots(2, len(columns), sharex=True, sharey="row", squeeze=False)
    for (above, below), ((classes, *_), of_column) in zip(axes.T, columns, strict=True):
        for proposer, rows in of_column.sort_values("map_objects").groupby("proposer", sort=False):
            above.plot(rows["map_objects"], 100.0 * rows["right"], marker="o", label=proposer)
            below.plot(rows["map_objects"], rows["propose_ms"], marker="o")
        seen, _, others = scenario_of(of_column.iloc[0].to_dict()).describe().partition(", ")
        above.set_title(f"{classes} classes, {seen}\n{others}", fontsize=8)
        below.set(xscale="log", yscale="log", xlabel="objects of the map")
    axes[0, 0].set_ylabel("right poses [%]")
    axes[1, 0].set_ylabel("time to propose [ms]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save_figure(figure, path_png)
