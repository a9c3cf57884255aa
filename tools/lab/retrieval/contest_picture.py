"""Picture of a contest: right poses and time of a query over the size of the map."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from slam.display.map_picture import save_figure

_GRID = "#e5e7eb"
_SCENARIO = ["map_classes", "objects", "missing", "clutter", "noise_m"]


def draw_contest(path_png: Path, cells: pd.DataFrame) -> None:
    """One column for each number of classes and scenario: above the right poses, below the time, over the size.

    Args:
        path_png: the picture.
        cells: as :func:`tools.lab.retrieval.contest.run_contest` returns them.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    groups = list(cells.groupby(_SCENARIO, sort=False))
    figure = Figure(figsize=(1.5 + 3.0 * len(groups), 6.0), layout="constrained", dpi=100)
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
    seen = f"{objects} objects" if objects else "objects of 50 m"
    kinds = "1 class" if classes == 1 else f"{classes} classes"
    return f"{kinds}, {seen}\n{missing:.0%} missing, {clutter:.0%} clutter, {noise_m:g} m"
