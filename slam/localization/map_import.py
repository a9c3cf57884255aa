"""From the objects of a source to an imported map: positions in a plane, and its georeference."""

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
        SavedMapError: positions that cannot be metres in the plane of one map, or are far from the origin; names the
            source.
        GeometryError: an origin that is no place.
    """
    positions = objects.positions
    if objects.is_geodetic:
        if origin is None:
            latitude, longitude = np.round(np.median(positions[:, :2], axis=0), 6).tolist()
            origin = Georeference(latitude, longitude)
        positions = origin.to_map(positions)
    if origin is not None:
        nearest_m = np.linalg.norm(positions[:, :2], axis=1).min(initial=np.inf)
        # Coordinates that are farther away count from elsewhere, as those of national grids do.
        if 200_000.0 < nearest_m < np.inf:
            raise SavedMapError(
                f"{objects.source}: the nearest object is {nearest_m / 1000.0:.0f} km from the origin at latitude "
                f"{origin.latitude_deg:g}, longitude {origin.longitude_deg:g}; give the origin of the coordinates, "
                "or convert those of a national grid (such as UTM) to latitude and longitude"
            )
    provenance = {"source": objects.source, "input_sha256": objects.sha256, "version": version("descriptellation-slam")}
    try:
        return make_imported_map(
            positions, objects.labels, objects.ids, sigma_m=sigma_m, georeference=origin, source=provenance
        )
    except SavedMapError as error:
        raise SavedMapError(f"{objects.source}: {error}") from error
