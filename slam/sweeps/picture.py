"""Precision, recall and trajectory error of a sweep by degradation."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from slam.display.map_picture import save_figure
from slam.evaluation.report.figures import HEADLINE_FIGURES
from slam.sweeps.sweep import Sweep

_SHOWN = {
    "closures.precision": "precision of closures",
    "closures.recall": "recall of closures",
    "trajectory.ate_m": "ATE [m]",
}
_MAX_LABEL_LENGTH = 26
_LOGARITHMIC_FROM = 10.0
"""An error that grows by more is drawn on a logarithmic scale."""


def draw_sweep(path_png: Path, sweep: Sweep) -> None:
    """One chart each for precision, recall and ATE: the mean of each degradation and variant, with the standard
    deviation over the seeds, where the figure is defined.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    rows = sweep.rows()
    degradations = list(dict.fromkeys(degradation for _, degradation in rows))
    figure = Figure(figsize=(max(6.0, 2.0 + 0.9 * len(degradations)), 9.0), layout="constrained", dpi=100)
    axes = figure.subplots(3, 1, sharex=True)
    for axis, (key, name) in zip(axes, _SHOWN.items(), strict=True):
        is_error = next(each.is_error for each in HEADLINE_FIGURES if each.key == key)
        spreads = pd.DataFrame(
            {(variant or "mean, standard deviation", degradation): cells[key].agg(["mean", "std"])
             for (variant, degradation), cells in rows.items()}
        )  # fmt: skip
        positive = spreads.loc["mean"][spreads.loc["mean"] > 0.0]
        is_wide = bool(positive.max() > _LOGARITHMIC_FROM * positive.min())
        for variant in spreads.columns.unique(0):
            mean, deviation = spreads[variant].to_numpy()
            axis.errorbar(range(len(mean)), mean, deviation, fmt="D", capsize=4, label=variant)
        axis.set(ylabel=name, yscale="log" if is_error and is_wide else "linear")
        if not is_error:
            axis.set_ylim(0.0, 1.06)
    labels = ["\n".join(part[:_MAX_LABEL_LENGTH] for part in each.split(",")) for each in degradations]
    axes[-1].set_xticks(range(len(labels)), labels, rotation=30, ha="right")
    axes[-1].legend()
    figure.suptitle(f"{sweep.first.log.stem}, degraded", x=0.01, ha="left", fontweight="bold")
    save_figure(figure, path_png)
