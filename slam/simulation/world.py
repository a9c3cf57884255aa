"""The world that is driven through: objects that stand still, and a tour past them."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from logs.importers.maps.object_table import read_object_table
from logs.records import frozen
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import travelled_m


@frozen
class World:
    """Objects and tour in the world frame, metres, z up.

    object_ids (N,) unique; positions (N, 3); labels (N,); tour (M, 2) poly-line with at least two different points.

    Raises:
        SimulationError: no object, or a tour of no length.
    """

    name: str
    object_ids: tuple[str, ...]
    positions: FloatArray
    labels: tuple[str, ...]
    tour: FloatArray

    def __post_init__(self) -> None:
        if not self.object_ids:
            raise SimulationError(f"world {self.name!r} has no object; give it at least one")
        if not self.tour_length_m > 0.0:
            raise SimulationError(f"world {self.name!r}: all {len(self.tour)} points of the tour are the same")

    @property
    def vocabulary(self) -> tuple[str, ...]:
        """The classes that occur, sorted."""
        return tuple(sorted(set(self.labels)))

    @property
    def tour_length_m(self) -> float:
        """Length of the poly-line, metres."""
        return travelled_m(self.tour)[-1]

    def shortened(self, length_m: float) -> "World":
        """The same world with the first ``length_m`` metres of the tour; the whole tour if it is no longer than that.

        Raises:
            SimulationError: ``length_m`` is not a positive length.
        """
        if not length_m > 0.0:
            raise SimulationError(f"length {length_m:g} m: a tour needs a length above 0 m")
        along_m = travelled_m(self.tour)
        if length_m >= along_m[-1]:
            return self
        end = [np.interp(length_m, along_m, axis) for axis in self.tour.T]
        return replace(self, tour=np.vstack([self.tour[along_m < length_m], end]))

    def sha256(self) -> str:
        """Digest over ids, labels, positions and tour."""
        digest = hashlib.sha256()
        for name, label in zip(self.object_ids, self.labels, strict=True):
            digest.update(f"{name}\0{label}\n".encode())
        digest.update(np.ascontiguousarray(self.positions, dtype="<f8").tobytes())
        digest.update(np.ascontiguousarray(self.tour, dtype="<f8").tobytes())
        return digest.hexdigest()


def load_world(objects: Path, trajectory: Path) -> World:
    """Read a world from two tables of objects, in metres (:func:`logs.importers.maps.object_table.read_object_table`).

    Its name is that of the folder that holds ``objects``.

    Args:
        objects: what stands in the world, with its classes and ids where known.
        trajectory: the points of the tour in order.

    Raises:
        DatasetError: a missing column, a cell that is no number, or degrees; names the file and the line.
        SimulationError: fewer than two poses.
    """
    there, tour = (read_object_table(path).in_metres() for path in (objects, trajectory))
    if len(tour.labels) < 2:
        raise SimulationError(f"{trajectory}: {len(tour.labels)} poses; a tour needs at least two")
    return World(objects.resolve().parent.name, there.ids, there.positions, there.labels, tour.positions[:, :2])
