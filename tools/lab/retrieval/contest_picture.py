"""A contest as a picture: right poses and times of each proposer over the size of the map."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slam.display.map_picture import save_figure
from tools.lab.retrieval.contest import scenario_of

QUERY = ["world", "map_classes", "objects", "missing", "clutter", "noise_m", "range_m"]
"""Columns that tell one query from all others."""


def draw_contest(path_png: Path, cells: pd.DataFrame) -> None:
    """A column for each query: right poses (top) and time (bottom) over the size of the map.

    Queries that were asked in maps of several sizes are drawn, or all if there are none.

    Args:
        path_png: the picture.
        cells: as :func:`tools.lab.retrieval.contest.run_contest` returns them.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    groups = [rows for _, rows in cells.groupby(QUERY, sort=False)]
    columns = [rows for rows in groups if rows["map_objects"].nunique() > 1] or groups
    colors = {name: f"C{number}" for number, name in enumerate(cells["proposer"].unique())}
    figure = Figure(figsize=(1.5 + 2.2 * len(columns), 6.0), layout="constrained", dpi=100)
    axes = figure.subplots(2, len(columns), sharex=True, sharey="row", squeeze=False)
    for (above, below), of_column in zip(axes.T, columns, strict=True):
        for proposer, rows in of_column.sort_values("map_objects").groupby("proposer", sort=False):
            style = {"color": colors[str(proposer)], "marker": "o"}
            above.plot(rows["map_objects"], 100.0 * rows["right"], **style)
            below.plot(rows["map_objects"], rows["propose_ms"], **style)
        first = of_column.iloc[0].to_dict()
        parts = [f"{first['map_classes']} classes", *scenario_of(first).describe().split(", ")]
        above.set_title("\n".join(", ".join(parts[row : row + 2]) for row in range(0, len(parts), 2)), fontsize=8)
        below.set(xscale="log", yscale="log", xlabel="objects of the map")
    axes[0, 0].set_ylabel("right poses [%]")
    axes[1, 0].set_ylabel("time to propose [ms]")
    lines = [Line2D([], [], color=color, marker="o", label=name) for name, color in colors.items()]
    figure.legend(handles=lines, loc="outside lower center", ncols=4)
    save_figure(figure, path_png)
