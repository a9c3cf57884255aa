"""From the objects of a source to an imported map: where they are in a plane, and where that lies on earth."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np

from logs.importers.maps.map_objects import MapObjects
from slam.common.errors import SavedMapError
from slam.common.georeference import Georeference
from slam.place_recognition.imported_map import ImportedMap, make_imported_map


def import_map(objects: MapObjects, *, sigma_m: float, origin: Georeference | None = None) -> ImportedMap:
    """The map of objects.

    Args:
        objects: in metres or in degrees.
        sigma_m: standard deviation of a coordinate of an object.
        origin: where the map has its origin; by default the median of objects in degrees, and unknown for metres.

    Raises:
        SavedMapError: positions that cannot be metres in the plane of one map; names the source.
        GeometryError: an origin that is no place.
    """
    positions = objects.positions
    if objects.is_geodetic:
        if origin is None:
            latitude, longitude = np.round(np.median(positions[:, :2], axis=0), 6).tolist()
            origin = Georeference(latitude, longitude)
        positions = origin.to_map(positions)
    provenance = {
        "source": objects.source,
        "input_sha256": objects.sha256,
        "version": version("descriptellation-slam"),
    }
    try:
        return make_imported_map(
            positions, objects.labels, objects.ids, sigma_m=sigma_m, georeference=origin, source=provenance
        )
    except SavedMapError as error:
        raise SavedMapError(f"{objects.source}: {error}") from error
