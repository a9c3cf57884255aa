"""The thresholds of the evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Self

import numpy as np
from pydantic import ConfigDict, PositiveFloat, PositiveInt, ValidationError
from pydantic.dataclasses import dataclass

from slam.common.arrays import BoolArray, FloatArray
from slam.common.errors import EvaluationError

SPACING_TOLERANCE = 0.05
"""Part of the query spacing by which keyframes may be closer: those placed every 2 m must not be thinned by half."""
SAME_HEADING_DEG, OPPOSITE_HEADING_DEG = 45.0, 135.0
"""Angles between the headings of two visits up to which they are the same, and beyond which they are opposite."""
WINDOW_LANDMARKS = 3
"""Fewest landmarks of a window: two leave no residual after their alignment."""
RANGE_M = 30.0
"""Sensor range for which the lengths of the protocol are given: those of papers, about cars in streets."""


@dataclass(frozen=True, slots=True, config=ConfigDict(extra="forbid"))
class Protocol:
    """Thresholds; units are in the names. All are positive, and lengths (``..._m``) are those usual for cars."""

    max_truth_gap_s: PositiveFloat = 1.5
    revisit_m: PositiveFloat = 100.0
    window_m: PositiveFloat = 50.0
    match_distance_m: PositiveFloat = 2.0
    least_detections: PositiveInt = 5
    closure_translation_m: PositiveFloat = 4.0
    closure_rotation_deg: PositiveFloat = 10.0
    query_spacing_m: PositiveFloat = 2.0
    revisit_distance_m: PositiveFloat = 5.0

    def is_true(self, error_m: FloatArray, rotation_rad: FloatArray) -> BoolArray:
        """Whether errors (N,) of poses are those of true closures and right fixes."""
        return (error_m <= self.closure_translation_m) & (np.rad2deg(rotation_rad) <= self.closure_rotation_deg)

    def for_range(self, sensor_range_m: float) -> Self:
        """The same with all lengths in proportion to a sensor range [m]."""
        lengths = [each.name for each in fields(self) if each.name.endswith("_m")]
        return self.with_thresholds({name: sensor_range_m / RANGE_M * getattr(self, name) for name in lengths})

    def with_thresholds(self, thresholds: Mapping[str, float]) -> Self:
        """The same with other thresholds, by name.

        Raises:
            EvaluationError: there is no such threshold, or it cannot have this value.
        """
        try:
            return replace(self, **thresholds)  # type: ignore[arg-type]
        except ValidationError as error:
            first, names = error.errors()[0], [each.name for each in fields(self)]
            why = first["msg"] if first["loc"][0] in names else f"no such threshold; there are {', '.join(names)}"
            raise EvaluationError(f"{first['loc'][0]} = {first['input']} of the evaluation protocol: {why}") from error
