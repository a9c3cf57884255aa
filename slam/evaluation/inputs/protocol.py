"""The thresholds of the evaluation."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from slam.common.arrays import BoolArray, FloatArray

SPACING_TOLERANCE = 0.05
"""Part of the query spacing by which keyframes may be closer: those placed every 2 m must not be thinned by half."""
SAME_HEADING_DEG, OPPOSITE_HEADING_DEG = 45.0, 135.0
"""Angles between the headings of two visits up to which they are the same, and beyond which they are opposite."""
WINDOW_LANDMARKS = 3
"""Fewest landmarks of a window: two leave no residual after their alignment."""
RANGE_M = 30.0
"""Sensor range for which the lengths of the protocol are given: those of papers, about cars in streets."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """Thresholds; units are in the names, and lengths (``..._m``) are those usual for cars."""

    max_truth_gap_s: float = 1.5
    revisit_m: float = 100.0
    window_m: float = 50.0
    least_detections: int = 5
    closure_translation_m: float = 4.0
    closure_rotation_deg: float = 10.0
    query_spacing_m: float = 2.0
    revisit_distance_m: float = 5.0

    def is_true(self, error_m: FloatArray, rotation_rad: FloatArray) -> BoolArray:
        """Whether errors (N,) of poses are those of true closures and right fixes."""
        return (error_m <= self.closure_translation_m) & (np.rad2deg(rotation_rad) <= self.closure_rotation_deg)

    def for_range(self, sensor_range_m: float) -> Self:
        """The same with all lengths in proportion to a sensor range [m]."""
        lengths = [each.name for each in fields(self) if each.name.endswith("_m")]
        return replace(self, **{name: sensor_range_m / RANGE_M * getattr(self, name) for name in lengths})
