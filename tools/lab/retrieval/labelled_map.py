"""A map of labelled objects, and which poses in it are right."""

import numpy as np

from logs.messages import ObjectMapRecord
from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import invert, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.simulation.world import World

RECALL_AT = (1, 5, 25)
"""Numbers of proposals among which a right pose is looked for."""


@frozen
class LabelledMap:
    """Objects (M, 3) m with labels (M,) in ``vocabulary``."""

    positions: FloatArray
    labels: IntArray
    vocabulary: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.labels)

    def first(self, count: int) -> "LabelledMap":
        """The first objects, up to a number."""
        return LabelledMap(self.positions[:count], self.labels[:count], self.vocabulary)

    def names(self, labels: IntArray) -> tuple[str, ...]:
        """The classes of labels (N,)."""
        return tuple(self.vocabulary[label] for label in labels.tolist())

    def to_record(self) -> ObjectMapRecord:
        """The same as confirmed landmarks, each of them seen once and known exactly."""
        ids = tuple(map(str, range(len(self))))
        return ObjectMapRecord.of_objects(ids, self.positions, self.labels, self.vocabulary, observations=1)


def labelled_map(world: World) -> LabelledMap:
    """The objects of a world, its classes numbered by their sorted names."""
    return LabelledMap(world.positions, np.searchsorted(world.vocabulary, world.labels), world.vocabulary)


def is_right(poses: FloatArray, truth: FloatArray) -> BoolArray:
    """Which poses (H, 4, 4) are within 4 m and 10 deg of a true one (R, 4, 4), as in the protocol of closures: (H,)."""
    T_error = invert(truth)[None] @ poses[:, None]
    is_near = Protocol().is_true(np.linalg.norm(T_error[..., :3, 3], axis=2), rotation_angle_rad(T_error))
    return np.asarray(is_near.any(axis=1))


def rank_of(poses: FloatArray, truth: FloatArray) -> int:
    """How many poses (H, 4, 4) stand before the first right one; the last of :data:`RECALL_AT` if none is."""
    return np.flatnonzero(is_right(poses, truth)).min(initial=RECALL_AT[-1])
