"""A contest as a picture: right poses and times of each proposer over the size of the map."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from slam.display.map_picture import save_figure
from tools.lab.retrieval.contest import scenario_of


def draw_contest(path_png: Path, cells: pd.DataFrame) -> None:
    """A column for each number of classes and query: right poses (top) and time (bottom) over the size of the map.

    Args:
        path_png: the picture.
        cells: as :func:`tools.lab.retrieval.contest.run_contest` returns them.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    columns = list(cells.groupby(["map_classes", "objects", "missing", "clutter", "noise_m", "range_m"], sort=False))
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
