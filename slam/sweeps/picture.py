"""Precision, recall and trajectory error of a sweep: curves over the strength, and the others beside them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from slam.evaluation.metrics.statistics import CHIEF_FIGURES, ChiefFigure
from slam.sweeps.degradations import describe_option, undegraded_strength
from slam.sweeps.sweep import Sweep, SweepRow
from slam.visualization.map_plot import save_figure

_SHOWN = {
    "closures.precision": "precision of closures",
    "closures.recall": "recall of closures",
    "trajectory.ate_m": "ATE [m]",
}
_SEED, _BEFORE, _GRID = "#d97706", "#6b7280", "#e5e7eb"
_VARIANTS = ("#0b5cad", "#15803d", "#be185d", "#7c3aed", "#0891b2", "#475569")
_LABEL_LENGTH = 26
_LOGARITHMIC_FROM = 10.0
"""An error that grows by more is drawn on a logarithmic scale."""

_Placed = Sequence[tuple[float, SweepRow]]
"""Rows with their places on the axis."""


def draw_sweep(path_png: Path, sweep: Sweep) -> None:
    """A row each for precision, recall and ATE; a column for each option that comes in two strengths or more, and one
    for the other degradations. Dots are the seeds, line and bars mean and standard deviation, dashes the log as it is.

    Raises:
        UnwritableLogError: the picture cannot be written.
    """
    undegraded = [row for row in sweep.rows if row.degradation.is_undegraded]
    curves, others = _arrange(sweep.rows)
    colors = dict(zip(sweep.variants, itertools.cycle(_VARIANTS), strict=False))
    widths = [3.4] * len(curves) + ([max(3.4, 1.0 + 0.9 * len(others))] if others else [])
    figure = Figure(figsize=(1.2 + sum(widths), 8.0), layout="constrained", dpi=100)
    axes = figure.subplots(3, len(widths), sharey="row", sharex="col", squeeze=False, width_ratios=widths)
    for row_of_axes, (key, name) in zip(axes, _SHOWN.items(), strict=True):
        chief = next(each for each in CHIEF_FIGURES if each.key == key)
        for axis, (option, rows) in zip(row_of_axes, curves.items(), strict=False):
            for variant, color in colors.items():
                own = [row for row in (*undegraded, *rows) if row.variant == variant]
                _draw_curve(axis, chief, _place(option, own), color)
        if others:
            _draw_beside(row_of_axes[-1], chief, list(enumerate(others)), colors)
        for axis in row_of_axes:
            _draw_undegraded(axis, chief, undegraded)
            axis.grid(color=_GRID)
            axis.set_axisbelow(True)
            axis.spines[["top", "right"]].set_visible(False)
        row_of_axes[0].set_ylabel(name)
        _set_limits(row_of_axes[0], chief, sweep.rows)
    for axis, option in zip(axes[-1], curves, strict=False):
        axis.set_xlabel(describe_option(option))
    if others:
        axes[-1, -1].set_xticks(range(len(others)), [_label(row) for row in others], rotation=30, ha="right")
        axes[-1, -1].set_xlim(-0.6, len(others) - 0.4)
    figure.suptitle(f"{sweep.drive.path.stem}, degraded", x=0.01, ha="left", fontweight="bold")
    figure.legend(handles=_legend(colors), loc="outside lower left", ncols=3, frameon=False)
    save_figure(figure, path_png)


def _arrange(rows: Sequence[SweepRow]) -> tuple[dict[str, list[SweepRow]], list[SweepRow]]:
    """Rows by the option of which they are strengths, and those that are in no curve."""
    by_option: dict[str, list[SweepRow]] = {}
    for row in rows:
        if row.degradation.strength is not None:
            by_option.setdefault(row.degradation.strength[0], []).append(row)
    curves = {option: members for option, members in by_option.items() if len(members) > 1}
    # One strength is no curve, whatever the number of variants.
    curves = {option: rows for option, rows in curves.items() if len({row.degradation.name for row in rows}) > 1}
    drawn = {row.degradation.name for members in curves.values() for row in members}
    others = [row for row in rows if row.degradation.name not in drawn]
    # The log as it is stands in each curve; alone it needs no column.
    return curves, others if len(others) > 1 or not curves else []


def _place(option: str, rows: Sequence[SweepRow]) -> _Placed:
    """Rows of one curve by their strengths; the log as it is is left out where its strength is beyond all numbers."""
    placed = []
    for row in rows:
        strength = row.degradation.strength
        x = undegraded_strength(option) if strength is None else strength[1]
        if x is not None:
            placed.append((x, row))
    return sorted(placed, key=lambda pair: pair[0])


def _draw_curve(axis: Axes, chief: ChiefFigure, placed: _Placed, color: str) -> None:
    _draw_seeds(axis, chief, placed)
    spreads = [row.spreads[chief.key] for _, row in placed]
    x = np.array([x for x, _ in placed])
    mean = np.array([spread.mean for spread in spreads], dtype=np.float64)  # None becomes NaN, a gap in the line
    deviation = np.array([spread.standard_deviation or 0.0 for spread in spreads])
    axis.fill_between(x, mean - deviation, mean + deviation, color=color, alpha=0.15, linewidth=0.0)
    axis.plot(x, mean, "-", color=color)
    _draw_means(axis, chief, placed, {row.variant: color for _, row in placed})


def _draw_beside(axis: Axes, chief: ChiefFigure, placed: _Placed, colors: Mapping[str, str]) -> None:
    _draw_seeds(axis, chief, placed)
    for x, row in placed:
        spread = row.spreads[chief.key]
        if spread.mean is not None and spread.standard_deviation is not None:
            axis.errorbar(x, spread.mean, spread.standard_deviation, color=colors[row.variant], capsize=4)
    _draw_means(axis, chief, placed, colors)


def _draw_means(axis: Axes, chief: ChiefFigure, placed: _Placed, colors: Mapping[str, str]) -> None:
    for x, row in placed:
        mean = row.spreads[chief.key].mean
        if mean is None:
            outcome = "failed" if all(result.error for _, result in row.results) else "undefined"
            axis.annotate(
                outcome,
                (x, 0.03),
                xycoords=("data", "axes fraction"),
                color=_BEFORE,
                rotation=90,
                ha="center",
                fontsize=8,
            )
        else:
            axis.plot(x, mean, "D", color=colors[row.variant], markersize=5)


def _draw_seeds(axis: Axes, chief: ChiefFigure, placed: _Placed) -> None:
    dots = [
        (x, value)
        for x, row in placed
        for _, result in row.results
        if (value := chief.of(result.evaluation or {})) is not None
    ]
    # Above the means, which they would hide where they agree.
    axis.plot([x for x, _ in dots], [y for _, y in dots], "o", color=_SEED, markersize=3, linestyle="none", zorder=4)


def _draw_undegraded(axis: Axes, chief: ChiefFigure, rows: Sequence[SweepRow]) -> None:
    for row in rows:
        mean = row.spreads[chief.key].mean
        if mean is not None:
            axis.axhline(mean, color=_BEFORE, linestyle="--", linewidth=0.9, zorder=0)


def _set_limits(axis: Axes, chief: ChiefFigure, rows: Sequence[SweepRow]) -> None:
    if not chief.is_error:
        axis.set_ylim(-0.04, 1.06)
        return
    values = [chief.of(result.evaluation or {}) or 0.0 for row in rows for _, result in row.results]
    largest, least = max(values, default=0.0), min((value for value in values if value > 0.0), default=1.0)
    if largest > _LOGARITHMIC_FROM * least:
        axis.set_yscale("log", subs=())
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.set_ylim(0.7 * least, 1.4 * largest)
    else:
        axis.set_ylim(0.0, 1.15 * largest or 1.0)


def _label(row: SweepRow) -> str:
    parts = [*row.degradation.name.split(","), *([row.variant] if row.variant else [])]
    return "\n".join(part if len(part) <= _LABEL_LENGTH else f"{part[: _LABEL_LENGTH - 1]}…" for part in parts)


def _legend(colors: Mapping[str, str]) -> list[Line2D]:
    return [
        Line2D([], [], color=_SEED, marker="o", markersize=3, linestyle="none", label="one seed"),
        *(
            Line2D([], [], color=color, marker="D", markersize=5, label=variant or "mean, standard deviation")
            for variant, color in colors.items()
        ),
        Line2D([], [], color=_BEFORE, linestyle="--", linewidth=0.9, label="as it is"),
    ]
