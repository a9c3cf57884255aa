"""The thresholds of the evaluation."""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from slam.common.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Protocol:
    """Thresholds; units are in the names, and lengths (``..._m``) are those of papers about cars in streets, with a
    sensor range of 30 m.
    """

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
        return replace(self, **{name: sensor_range_m / 30.0 * getattr(self, name) for name in lengths})
