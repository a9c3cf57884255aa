"""Objects of a map in GeoJSON (RFC 7946): its points, longitude before latitude."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects, check_degrees
from logs.importers.maps.object_table import CLASS_NAMES, ID_NAMES, UNKNOWN
from logs.importers.tables import read_source_text

_GLOBAL_CRS = ("CRS84", "4326", "WGS84", "4979")


def read_geojson(path: Path, *, class_property: str | None = None) -> MapObjects:
    """Read the points of a FeatureCollection.

    Args:
        path: the file, packed by gzip or not.
        class_property: which property is the class; by default the first there is of ``class``, ``label``, ...

    Raises:
        DatasetError: no GeoJSON, no point in it, coordinates that are no degrees, or no such property.
    """
    source = read_source_text(path)
    try:
        content = json.loads(source.text)
    except json.JSONDecodeError as error:
        raise DatasetError(
            f"{path}, line {error.lineno}: not JSON ({error.msg}, character {error.colno}); the file may be cut off"
        ) from error
    except (RecursionError, ValueError) as error:
        raise DatasetError(
            f"{path}: nested too deeply, or numbers too long ({error}); export the layer again"
        ) from error
    if not isinstance(content, dict) or content.get("type") != "FeatureCollection":
        raise DatasetError(f"{path}: no GeoJSON FeatureCollection; export the layer as GeoJSON")
    crs = str(content.get("crs", ""))
    if crs and not any(name in crs.replace("::", ":").replace(" ", "").upper() for name in _GLOBAL_CRS):
        raise DatasetError(f"{path}: coordinates of {crs[:80]}; export the layer in WGS 84 (EPSG:4326)")
    positions, labels, ids, others = list[list[float]](), list[str](), list[str](), 0
    features = content.get("features")
    for number, feature in enumerate(features if isinstance(features, list) else [], start=1):
        points = list(_points(path, number, feature))
        others += not points
        if not points:
            continue
        properties = feature.get("properties") or {}
        label = _first(properties, (class_property,) if class_property else CLASS_NAMES)
        for part, point in enumerate(points):
            positions.append(point)
            labels.append(label or UNKNOWN)
            name = str(feature.get("id") or _first(properties, ID_NAMES) or number)
            ids.append(name if part == 0 else f"{name}/{part}")
    geodetic = np.array(positions).reshape(-1, 3)
    check_degrees(str(path), geodetic)
    if class_property and all(label == UNKNOWN for label in labels):
        raise DatasetError(f"{path}: no feature has a property {class_property!r}; see the properties of the layer")
    notes = (f"{others} features that are no points were left out",) if others else ()
    return MapObjects(str(path), geodetic, tuple(labels), _distinct(ids), True, source.sha256, notes)


def _points(path: Path, number: int, feature: Any) -> Iterator[list[float]]:
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    if not isinstance(geometry, dict) or geometry.get("type") not in ("Point", "MultiPoint"):
        return
    coordinates: Any = geometry.get("coordinates")
    for point in [coordinates] if geometry["type"] == "Point" else coordinates or []:
        try:
            longitude, latitude, *height = (float(value) for value in point)
        except (TypeError, ValueError) as error:
            raise DatasetError(f"{path}, feature {number}: {point!r:.60} is no position; give [lon, lat]") from error
        yield [latitude, longitude, height[0] if height else 0.0]


def _first(properties: Mapping[str, Any], names: tuple[str, ...]) -> str:
    lower = {key.lower(): value for key, value in properties.items()}
    return next((str(lower[name.lower()]) for name in names if lower.get(name.lower()) not in (None, "")), "")


def _distinct(ids: list[str]) -> tuple[str, ...]:
    """The ids, those that occur before with their place behind."""
    seen: set[str] = set()
    distinct = []
    for place, name in enumerate(ids):
        distinct.append(f"{name}#{place}" if name in seen else name)
        seen.add(distinct[-1])
    return tuple(distinct)
