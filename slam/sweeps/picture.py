"""Precision, recall and trajectory error of a sweep by degradation."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from slam.display.map_picture import save_figure
from slam.sweeps.sweep import Sweep

_SHOWN = {
    "closures.precision": "precision of closures",
    "closures.recall": "recall of closures",
    "trajectory.ate_m": "ATE [m]",
}


def draw_sweep(path_png: Path, sweep: Sweep) -> None:
    """One chart each for precision, recall and ATE: the mean of each degradation and variant, with the standard
    deviation over the seeds, where the figure is defined.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    cells = pd.concat(
        {(degradation, variant): each for (variant, degradation), each in sweep.rows().items()},
        names=["degradation", "variant"],
    )
    degradations = cells.index.unique("degradation")
    figure = Figure(figsize=(max(6.0, 2.0 + 0.9 * len(degradations)), 9.0), layout="constrained", dpi=100)
    axes = figure.subplots(3, 1, sharex=True)
    for axis, (key, name) in zip(axes, _SHOWN.items(), strict=True):
        spreads = cells[key].groupby(["variant", "degradation"], sort=False).agg(["mean", "std"])
        for variant, spread in spreads.groupby("variant", sort=False):
            mean, deviation = spread.droplevel("variant").reindex(degradations).to_numpy().T
            label = variant or "mean, standard deviation"
            axis.errorbar(range(len(mean)), mean, deviation, fmt="D", capsize=4, label=label)
        axis.set(ylabel=name)
    axes[-1].set_xticks(range(len(degradations)), degradations, rotation=30, ha="right")
    axes[-1].legend()
    figure.suptitle(f"{sweep.first.log.stem}, degraded", x=0.01, ha="left", fontweight="bold")
    save_figure(figure, path_png)
