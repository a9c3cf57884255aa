"""Fractions and percentiles; undefined values are None."""

from collections.abc import Iterable

import numpy as np

CONFIDENCE = 0.95
"""Confidence level of statistical statements."""


def fraction(part: int, whole: int) -> float | None:
    """``part / whole``; None of nothing."""
    return part / whole if whole else None


def percentile(values: Iterable[float | None], percent: float) -> float | None:
    """The percentile of the values that are defined; None where none is."""
    known = [value for value in values if value is not None]
    return float(np.percentile(known, percent)) if known else None
