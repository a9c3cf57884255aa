"""Objects of a map in GeoJSON (RFC 7946): its points, longitude before latitude."""

from collections import Counter
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, FiniteFloat, ValidationError

from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects, objects_of
from logs.importers.tables import Table
from logs.importers.text_files import read_source_text


class _Point(BaseModel):
    type: Literal["Point"]
    coordinates: tuple[FiniteFloat, FiniteFloat] | tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class _OtherGeometry(BaseModel):
    type: Literal["MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon", "GeometryCollection"]


class _Feature(BaseModel):
    geometry: _Point | _OtherGeometry | None = None
    properties: dict[str, Any] | None = None
    id: str | int | None = None


class _FeatureCollection(BaseModel):
    type: Literal["FeatureCollection"]
    features: list[_Feature]


def read_geojson(path: Path) -> MapObjects:
    """Read the points of a FeatureCollection, packed by gzip or not.

    Raises:
        DatasetError: no GeoJSON, no point in it, or coordinates that are no degrees.
    """
    source = read_source_text(path)
    try:
        collection = _FeatureCollection.model_validate_json(source.text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"][:3]))
        raise DatasetError(
            f"{path}: not a GeoJSON FeatureCollection ({place}: {first['msg'][:200]}); it may be truncated, export the "
            "layer again"
        ) from error
    coordinates, properties, names, others = [], list[dict[str, Any]](), [], Counter[str]()
    for i, feature in enumerate(collection.features, start=1):
        if isinstance(feature.geometry, _Point):
            longitude, latitude, *altitude = feature.geometry.coordinates
            coordinates.append((latitude, longitude, *(altitude or [0.0])))
            properties.append(feature.properties or {})
            names.append(str(feature.id or properties[-1].get("id") or i))
        else:
            others[feature.geometry.type if feature.geometry else "without geometry"] += 1
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
    if others and not coordinates:
        raise DatasetError(f"{path}: none of its features is a point ({kinds}); export points, for example centroids")
    keys = sorted({key for row in properties for key in row})
    cells = {key: ["" if row.get(key) is None else str(row[key]) for row in properties] for key in keys}
    table = Table(str(path), range(1, len(properties) + 1), cells)
    notes = (f"{others.total()} features that are not points were ignored ({kinds})",) if others else ()
    geodetic = np.array(coordinates).reshape(-1, 3)
    return objects_of(table, geodetic, names, source.sha256, is_geodetic=True, notes=notes)
