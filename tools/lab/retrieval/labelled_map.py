"""A map of labelled objects, and which poses in it are right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import invert, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol

RECALL_AT = (1, 5, 25)
"""Numbers of proposals among which a right pose is looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledMap:
    """Objects (M, 3) m with labels (M,) in ``vocabulary``."""

    positions: FloatArray
    labels: IntArray
    vocabulary: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.labels)

    def first(self, count: int) -> LabelledMap:
        """The first objects, up to a number."""
        return LabelledMap(self.positions[:count], self.labels[:count], self.vocabulary)


def is_right(poses: FloatArray, truth: FloatArray) -> BoolArray:
    """Which poses (H, 4, 4) are within 4 m and 10 deg of a true one (R, 4, 4), as in the protocol of closures: (H,)."""
    T_error = invert(truth)[None] @ poses[:, None]
    is_near = Protocol().is_true(np.linalg.norm(T_error[..., :3, 3], axis=2), rotation_angle_rad(T_error))
    return np.asarray(is_near.any(axis=1))
