"""Objects of a map as a source has them, in metres or in degrees."""

from collections.abc import Iterable

import numpy as np

from logs.errors import DatasetError
from logs.importers.tables import LABEL_NAMES, UNLABELLED, Table
from logs.messages import FloatArray
from logs.records import frozen


@frozen
class MapObjects:
    """``positions`` (N, 3): x, y, z in metres, or, where ``is_geodetic``, latitude and longitude in degrees and
    altitude in metres; ``labels`` (N,) classes; ``ids`` (N,) names in the source.

    ``sha256`` of the source; ``notes``: what was left out, for people.
    """

    source: str
    positions: FloatArray
    labels: tuple[str, ...]
    ids: tuple[str, ...]
    is_geodetic: bool
    sha256: str
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.labels)

    def in_metres(self) -> "MapObjects":
        """The same objects.

        Raises:
            DatasetError: they are in degrees.
        """
        if self.is_geodetic:
            raise DatasetError(f"{self.source}: positions in degrees; give metres")
        return self


def objects_of(
    table: Table,
    positions: FloatArray,
    names: Iterable[str],
    sha256: str,
    *,
    is_geodetic: bool,
    notes: tuple[str, ...] = (),
) -> MapObjects:
    """The objects (N,) in the rows of ``table``, at ``positions`` (N, 3), with ids by their ``names`` in the source.

    Raises:
        DatasetError: positions that should be degrees and cannot be.
    """
    if is_geodetic:
        _check_degrees(table.name, positions)
    labels = tuple(label or UNLABELLED for label in table.first_texts(LABEL_NAMES))
    return MapObjects(table.name, positions, labels, _distinct(names), is_geodetic, sha256, notes)


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    """The names, those that occur before with their place behind."""
    seen = set()
    found = []
    for place, name in enumerate(names):
        found.append(f"{name}#{place}" if name in seen else name)
        seen.add(found[-1])
    return tuple(found)


def _check_degrees(source: str, geodetic: FloatArray) -> None:
    """Refuse latitudes and longitudes (N, 3) that cannot be degrees.

    Raises:
        DatasetError: metres, or the two the other way round; with the values and the remedy.
    """
    if not len(geodetic):
        raise DatasetError(f"{source} holds no objects; give at least four")
    plane, limits = np.abs(geodetic[:, :2]), (90.0, 180.0)
    wrong = ~(plane <= limits).all(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        is_swapped = (plane[:, ::-1] <= limits).all()
        raise DatasetError(
            f"{source}: latitude {geodetic[row, 0]:g}, longitude {geodetic[row, 1]:g} of object {row + 1} are not "
            f"degrees; {'they are swapped: exchange the columns' if is_swapped else 'these are metres or another unit'}"
        )
