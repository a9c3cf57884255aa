"""Precision, recall and trajectory error of a sweep by degradation."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slam.display.map_picture import save_figure
from slam.evaluation.report.figures import HEADLINE_FIGURES
from slam.evaluation.report.figures import Figure as Headline
from slam.sweeps.degradations import Degradation
from slam.sweeps.sweep import Sweep, SweepRow

_SHOWN = {
    "closures.precision": "precision of closures",
    "closures.recall": "recall of closures",
    "trajectory.ate_m": "ATE [m]",
}
_SEED, _BEFORE, _GRID = "#d97706", "#6b7280", "#e5e7eb"
_VARIANTS = ("#0b5cad", "#15803d", "#be185d", "#7c3aed", "#0891b2", "#475569")
_MAX_LABEL_LENGTH = 26
_LOGARITHMIC_FROM = 10.0
"""An error that grows by more is drawn on a logarithmic scale."""


def draw_sweep(path_png: Path, sweep: Sweep) -> None:
    """One chart each for precision, recall and ATE over the degradations, of which the strengths of one option are a
    line. Dots are the seeds, bars mean and standard deviation, dashes the log as it is.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    unique = {row.degradation.name: row.degradation for row in sweep.rows}
    degradations = sorted(unique.values(), key=lambda each: _option_and_strength(each, list(unique)))
    place_of = {degradation.name: float(place) for place, degradation in enumerate(degradations)}
    colors = dict(zip(sweep.variants, itertools.cycle(_VARIANTS), strict=False))
    figure = Figure(figsize=(max(6.0, 2.0 + 0.9 * len(degradations)), 9.0), layout="constrained", dpi=100)
    axes = figure.subplots(3, 1, sharex=True)
    for axis, (key, name) in zip(axes, _SHOWN.items(), strict=True):
        headline = next(each for each in HEADLINE_FIGURES if each.key == key)
        axis.set_ylabel(name)
        axis.grid(color=_GRID)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        for row in sweep.rows:
            mean = row.spreads[key].mean
            if row.degradation.is_undegraded and mean is not None:
                axis.axhline(mean, color=_BEFORE, linestyle="--", linewidth=0.9, zorder=0, label="as it is")
        for variant, color in colors.items():
            rows = sorted((r for r in sweep.rows if r.variant == variant), key=lambda r: place_of[r.degradation.name])
            for _, group in itertools.groupby(rows, key=lambda row: (row.degradation.strength or (row.name,))[0]):
                _draw_rows(axis, headline, list(group), place_of, color)
        _set_limits(axis, headline, sweep)
    labels = ["\n".join(part[:_MAX_LABEL_LENGTH] for part in each.name.split(",")) for each in degradations]
    axes[-1].set_xticks(range(len(labels)), labels, rotation=30, ha="right")
    figure.suptitle(f"{sweep.drive.path.stem}, degraded", x=0.01, ha="left", fontweight="bold")
    handles, names = axes[0].get_legend_handles_labels()
    shown = dict(zip(names, handles, strict=True))
    figure.legend(shown.values(), shown.keys(), loc="outside lower left", ncols=3, frameon=False)
    save_figure(figure, path_png)


def _option_and_strength(degradation: Degradation, order: list[str]) -> tuple[int, float]:
    """Sorts strengths of one option beside each other, where the first of them was given."""
    strength = degradation.strength
    if strength is None:
        return order.index(degradation.name), 0.0
    first = next(place for place, name in enumerate(order) if name.startswith(f"{strength[0]}="))
    return first, strength[1]


def _draw_rows(axis: Axes, headline: Headline, rows: list[SweepRow], place_of: dict[str, float], color: str) -> None:
    places = [place_of[row.degradation.name] for row in rows]
    spreads = [row.spreads[headline.key] for row in rows]
    mean = np.array([spread.mean for spread in spreads], dtype=np.float64)  # None becomes NaN, a gap in the line
    deviation = np.array([spread.standard_deviation or 0.0 for spread in spreads])
    name = rows[0].variant or "mean, standard deviation"
    axis.errorbar(places, mean, deviation, fmt="D-", color=color, ms=5, capsize=4, label=name)
    for place, row, spread in zip(places, rows, spreads, strict=True):
        values = [headline.of(result.evaluation or {}) for _, result in row.results]
        known = [value for value in values if value is not None]
        # Above the means, which they would hide where they agree.
        axis.plot([place] * len(known), known, "o", color=_SEED, ms=3, zorder=4, label="one seed")
        if spread.mean is None:
            outcome = "failed" if row.failed_count == len(row.results) else "undefined"
            middle = axis.get_xaxis_transform()
            axis.text(place, 0.03, outcome, transform=middle, color=_BEFORE, rotation=90, ha="center", fontsize=8)


def _set_limits(axis: Axes, headline: Headline, sweep: Sweep) -> None:
    if not headline.is_error:
        axis.set_ylim(-0.04, 1.06)
        return
    values = [headline.of(result.evaluation or {}) or 0.0 for _, result in sweep.results]
    largest, least = max(values, default=0.0), min((value for value in values if value > 0.0), default=1.0)
    if largest > _LOGARITHMIC_FROM * least:
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter("{x:g}")
    else:
        axis.set_ylim(0.0, 1.15 * largest or 1.0)
