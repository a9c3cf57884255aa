"""The picture of :mod:`tools.lab.descriptors.map_size`: time and success over the size of the map."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

from matplotlib.figure import Figure

from slam.visualization.map_plot import save_figure
from tools.lab.descriptors.map_size import SizeCell

_COLORS = ("#0b5cad", "#d97706", "#2e9e5b", "#8456c4")


def draw_map_size(path_png: Path, cells: Sequence[SizeCell]) -> None:
    """One column for each scenario, success above time; the 95th percentile of the time is thin.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    scenarios = list(dict.fromkeys(cell.scenario for cell in cells))
    methods = list(dict.fromkeys(cell.method for cell in cells))
    figure = Figure(figsize=(12.0, 6.5), layout="constrained")
    axes = figure.subplots(2, len(scenarios), sharex=True, sharey="row", squeeze=False)
    for column, scenario in enumerate(scenarios):
        success, time = axes[0, column], axes[1, column]
        success.set_title(scenario, loc="left", fontweight="bold")
        for method, color in zip(methods, cycle(_COLORS), strict=False):
            line = [cell for cell in cells if (cell.method, cell.scenario) == (method, scenario)]
            sizes = [cell.objects for cell in line]
            success.plot(sizes, [100.0 * cell.success for cell in line], "o-", color=color, label=method)
            time.plot(sizes, [cell.median_ms for cell in line], "o-", color=color)
            time.plot(sizes, [cell.p95_ms for cell in line], "-", color=color, linewidth=0.7)
        success.set_ylim(0.0, 103.0)
        time.set(xscale="log", yscale="log", xlabel="objects in the map")
        for each in (success, time):
            each.grid(color="#e5e7eb")
            each.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_ylabel("within 1 m [%]")
    axes[1, 0].set_ylabel("one query [ms]: median, 95th percentile thin")
    axes[0, 0].legend(frameon=False)
    save_figure(figure, path_png)
