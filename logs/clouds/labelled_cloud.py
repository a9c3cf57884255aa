"""A point cloud of which each point has a class, and perhaps an instance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.errors import DatasetError
from logs.messages import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class LabelledCloud:
    """positions (N, 3) m; classes (N,); instances (N,), 0: none, or None where the cloud tells no instances.

    Raises:
        DatasetError: numbers of positions, classes and instances that differ.
    """

    positions: FloatArray
    classes: IntArray
    instances: IntArray | None = None

    def __post_init__(self) -> None:
        counts = [len(self.positions), len(self.classes)]
        counts += [len(self.instances)] if self.instances is not None else []
        if len(set(counts)) != 1 or self.positions.shape[1:] != (3,):
            raise DatasetError(
                f"a cloud of {counts[0]} points has {', '.join(map(str, counts[1:]))} labels; give one for each point"
            )

    def finite(self) -> LabelledCloud:
        """The cloud without the points that have NaN or Inf: beams that hit nothing."""
        is_finite = np.isfinite(self.positions).all(axis=1)
        if is_finite.all():
            return self
        instances = self.instances[is_finite] if self.instances is not None else None
        return LabelledCloud(self.positions[is_finite], self.classes[is_finite], instances)
