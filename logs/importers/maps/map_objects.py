"""Objects of a map as a source has them, in metres or in degrees."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.messages import FloatArray

MAX_LATITUDE_DEG, MAX_LONGITUDE_DEG = 90.0, 180.0


@dataclass(frozen=True, slots=True, eq=False)
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

    def relabelled(self, label: str) -> MapObjects:
        """The same objects, all of one class."""
        return replace(self, labels=(label,) * len(self))


def distinct(names: Iterable[str]) -> tuple[str, ...]:
    """The names, those that occur before with their place behind."""
    seen: set[str] = set()
    found = []
    for place, name in enumerate(names):
        found.append(f"{name}#{place}" if name in seen else name)
        seen.add(found[-1])
    return tuple(found)


def check_degrees(source: str, geodetic: FloatArray) -> None:
    """Refuse latitudes and longitudes (N, 3) that cannot be degrees.

    Raises:
        DatasetError: metres, or the two the other way round; with the values and the remedy.
    """
    if not len(geodetic):
        raise DatasetError(f"{source} holds no objects; give at least four")
    wrong = _outside(geodetic[:, 0], geodetic[:, 1])
    if not wrong.any():
        return
    row = int(wrong.argmax())
    latitude, longitude = geodetic[row, :2]
    is_swapped = not _outside(geodetic[:, 1], geodetic[:, 0]).any()
    remedy = (
        "latitude and longitude are swapped: exchange the columns" if is_swapped else "these are metres or another unit"
    )
    raise DatasetError(
        f"{source}: latitude {latitude:g}, longitude {longitude:g} of object {row + 1} are not degrees; {remedy}"
    )


def _outside(latitude: FloatArray, longitude: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(
        ~(np.abs(latitude) <= MAX_LATITUDE_DEG) | ~(np.abs(longitude) <= MAX_LONGITUDE_DEG), dtype=np.bool_
    )
