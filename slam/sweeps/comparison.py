"""Comparison of groups of drives: differences between groups that exceed those between repetitions."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from slam.evaluation.metrics.statistics import CONFIDENCE
from slam.sweeps.mapped_drive import MappedDrive

ERRORS = (
    "trajectory.ate_m",
    "trajectory.rpe_translation_percent",
    "trajectory.rpe_rotation_deg_per_100m",
    "closures.median_translation_error_m",
    "landmarks.median_error_m",
)
SHARES = (
    "closures.precision",
    "closures.recall",
    "closures.recall_opposite",
    "relocalization.success_rate",
    "associations.precision",
    "associations.recall",
    "landmarks.precision",
    "landmarks.recall",
)
"""Figures that are better the larger they are."""
RULE = (
    "A group is marked where its mean differs from that of the first group by more than "
    "2 pooled standard deviations of the runs within all groups, and by more than the "
    f"{100.0 * (1.0 - CONFIDENCE):.0f} % significance limit of one comparison (Student's t)."
)
NO_SPREAD = "No group has two runs, so the spread of the seeds is unknown and no difference is marked."


def compare(labels: Sequence[str], drives: Sequence[MappedDrive]) -> pd.DataFrame:
    """Spread of each figure in each group of runs.

    Args:
        labels: (N,) the group of each run; all are compared with the first.
        drives: (N,) the runs.

    Returns:
        A row for each group and key of a figure: ``mean``, ``standard_deviation`` (n - 1), ``least`` and ``greatest``,
        NaN where they are undefined; ``count`` of the runs in which the figure is defined, and ``run_count``; ``mark``:
        "* better" or "* worse" where :data:`RULE` says so, else "".
    """
    figures = {key: [drive.figure(key) for drive in drives] for key in (*ERRORS, *SHARES)}
    values = pd.DataFrame(figures, index=pd.Index(labels), dtype=float).stack(future_stack=True)
    spreads = values.groupby(level=[0, 1], sort=False).agg(
        mean="mean", standard_deviation="std", count="count", run_count="size", least="min", greatest="max"
    )
    marks = [_marks(group, is_error=key in ERRORS) for key, group in spreads.groupby(level=1, sort=False)]
    return spreads.assign(mark=pd.concat(marks))


def note_of(spreads: pd.DataFrame) -> str:
    """How differences are marked, or why none is."""
    return RULE if (spreads["run_count"] > 1).any() else NO_SPREAD


def _marks(spreads: pd.DataFrame, *, is_error: bool) -> pd.Series:
    """The marks of the groups by the spreads of one figure."""
    count, mean = spreads["count"], spreads["mean"]
    difference = mean - mean.iloc[0]
    freedom = (count - 1).clip(lower=0).sum()
    pooled = np.sqrt((spreads["standard_deviation"] ** 2 * (count - 1)).sum() / freedom) if freedom else np.inf
    student = stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE) * np.sqrt(1.0 / count + (1.0 / count).iloc[0])
    # What two ways of adding up the same numbers may differ by.
    rounding = 1e-9 * np.maximum(mean.abs(), abs(mean.iloc[0]))
    is_different = difference.abs() > pooled * np.maximum(2.0, student) + rounding
    return pd.Series(np.where((difference < 0.0) == is_error, "* better", "* worse"), spreads.index).where(
        is_different, ""
    )
