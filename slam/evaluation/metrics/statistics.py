"""Fractions, percentiles, and the mean and spread of a figure over several runs; undefined values are None."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import fmean, stdev

import numpy as np

UNDEFINED = "–"
CONFIDENCE = 0.95
"""Confidence level of statistical statements."""


def fraction(part: int, whole: int) -> float | None:
    """``part / whole``; None of nothing."""
    return part / whole if whole else None


def percentile(values: Iterable[float | None], percent: float) -> float | None:
    """The percentile of the values that are defined; None where none is."""
    known = [value for value in values if value is not None]
    return float(np.percentile(known, percent)) if known else None


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and standard deviation (of a sample, with n - 1) of ``count`` values of ``run_count`` runs, and extremes.

    Without values, the mean and the extremes are None; with fewer than two, the deviation is None.
    """

    mean: float | None
    standard_deviation: float | None
    count: int
    run_count: int
    least: float | None
    greatest: float | None

    @staticmethod
    def over(values: Iterable[float | None]) -> Spread:
        """The spread of the values that are defined."""
        every = list(values)
        defined = [value for value in every if value is not None]
        mean = fmean(defined) if defined else None
        deviation = stdev(defined) if len(defined) > 1 else None
        extremes = min(defined, default=None), max(defined, default=None)
        return Spread(mean, deviation, len(defined), len(every), *extremes)

    def text(self, digits: int) -> str:
        """ "1.27 ± 0.03"; with the number of runs in which it is defined, where that is not all."""
        if self.mean is None:
            return UNDEFINED
        deviation = "" if self.standard_deviation is None else f" ± {self.standard_deviation:.{digits}f}"
        part = "" if self.count == self.run_count else f" ({self.count} of {self.run_count})"
        return f"{self.mean:.{digits}f}{deviation}{part}"
