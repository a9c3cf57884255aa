"""The figures that tell most about a run, and their mean and spread over several runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

UNDEFINED = "–"


@dataclass(frozen=True, slots=True)
class ChiefFigure:
    """A number of an evaluation by its dotted key, with a short heading; ``is_error``: the smaller, the better."""

    key: str
    heading: str
    digits: int
    is_error: bool = False

    def of(self, results: Mapping[str, Any]) -> float | None:
        """Its value in an evaluation's JSON; None where it is undefined or not there."""
        value: Any = results
        for part in self.key.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


CHIEF_FIGURES = (
    ChiefFigure("trajectory.ate_m", "ATE m", 3, is_error=True),
    ChiefFigure("trajectory.rpe_translation_percent", "RPE %", 3, is_error=True),
    ChiefFigure("trajectory.rpe_rotation_deg_per_100m", "RPE deg/100 m", 4, is_error=True),
    ChiefFigure("closures.precision", "closures precision", 3),
    ChiefFigure("closures.recall", "closures recall", 3),
    ChiefFigure("closures.recall_opposite", "closures recall, opposite", 3),
    ChiefFigure("closures.average_precision", "average precision", 3),
    ChiefFigure("closures.f1_max", "largest F1", 3),
    ChiefFigure("closures.median_translation_error_m", "closures error m", 3, is_error=True),
    ChiefFigure("relocalization.success_rate", "relocalizations right", 3),
    ChiefFigure("associations.precision", "associations precision", 4),
    ChiefFigure("associations.recall", "associations recall", 4),
    ChiefFigure("landmarks.precision", "landmarks precision", 4),
    ChiefFigure("landmarks.recall", "landmarks recall", 4),
    ChiefFigure("landmarks.median_error_m", "landmarks error m", 3, is_error=True),
)


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and standard deviation (of a sample, with n - 1) of ``count`` values of ``run_count`` runs.

    The mean of nothing, and the deviation of fewer than two, is None.
    """

    mean: float | None
    standard_deviation: float | None
    count: int
    run_count: int

    @staticmethod
    def over(values: Iterable[float | None]) -> Spread:
        """The spread of the values that are defined."""
        every = list(values)
        defined = [value for value in every if value is not None]
        count = len(defined)
        if count == 0:
            return Spread(None, None, 0, len(every))
        mean = math.fsum(defined) / count
        if count == 1:
            return Spread(mean, None, 1, len(every))
        # Equal values have a mean that is off by a rounding; their deviation is none.
        squares = 0.0 if min(defined) == max(defined) else math.fsum((value - mean) ** 2 for value in defined)
        return Spread(mean, math.sqrt(squares / (count - 1)), count, len(every))

    def text(self, digits: int) -> str:
        """ "1.27 ± 0.03"; with the number of runs in which it is defined, where that is not all."""
        if self.mean is None:
            return UNDEFINED
        deviation = "" if self.standard_deviation is None else f" ± {self.standard_deviation:.{digits}f}"
        part = "" if self.count == self.run_count else f" ({self.count} of {self.run_count})"
        return f"{self.mean:.{digits}f}{deviation}{part}"
