"""Objects of a map in GeoJSON (RFC 7946): its points, longitude before latitude."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from logs.container.json_text import parse_json
from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects, check_degrees
from logs.importers.maps.object_table import CLASS_NAMES, ID_NAMES, find_ids, find_labels
from logs.importers.tables import Table
from logs.importers.text_files import read_source_text

_MAX_KIND_LENGTH = 30
_GLOBAL_CRS = ("CRS84", "4326", "WGS84", "4979")


def read_geojson(path: Path) -> MapObjects:
    """Read the points of a FeatureCollection, or of features of which each has a line, packed by gzip or not.

    Raises:
        DatasetError: no GeoJSON, no point in it, or coordinates that are no degrees.
    """
    source = read_source_text(path)
    positions, rows, others = list[list[float]](), list[dict[str, str]](), Counter[str]()
    for number, feature in enumerate(_features(path, source.text), start=1):
        geometry, properties = _part(feature, "geometry"), _part(feature, "properties")
        kind = geometry.get("type")
        if kind not in ("Point", "MultiPoint"):
            others[kind[:_MAX_KIND_LENGTH] if isinstance(kind, str) else "without geometry"] += 1
            continue
        texts = {key: str(value) for key, value in properties.items() if key.lower() in CLASS_NAMES + ID_NAMES}
        identity = {"id": str(feature.get("id") or texts.get("id") or number)}
        coordinates = geometry.get("coordinates")
        points = coordinates if kind == "MultiPoint" else [coordinates]
        for point in points if isinstance(points, list) else []:
            positions.append(_position(path, number, point))
            rows.append(texts | identity)
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
    if others and not positions:
        raise DatasetError(f"{path}: none of its features is a point ({kinds}); export points, for example centroids")
    geodetic = np.array(positions).reshape(-1, 3)
    check_degrees(str(path), geodetic)
    table = Table(str(path), pd.DataFrame(rows, dtype=object).replace("None", "").fillna(""))
    notes = (f"{others.total()} features that are not points were ignored ({kinds})",) if others else ()
    return MapObjects(str(path), geodetic, find_labels(table), find_ids(table), True, source.sha256, notes)


def _part(feature: Any, name: str) -> dict[str, Any]:
    """An object in a feature; an empty one where there is none."""
    part = feature.get(name) if isinstance(feature, dict) else None
    return part if isinstance(part, dict) else {}


def _position(path: Path, number: int, point: Any) -> list[float]:
    try:
        longitude, latitude, *height = (float(value) for value in point)
    except (TypeError, ValueError, OverflowError) as error:
        raise DatasetError(f"{path}, feature {number}: {point!r:.60} is not a position; give [lon, lat]") from error
    return [latitude, longitude, height[0] if height else 0.0]


def _features(path: Path, text: str) -> list[Any]:
    """The features of a FeatureCollection, or of a file that has one in each line (RFC 8142)."""
    lines = [(i, line) for i, line in enumerate(text.replace("\x1e", "").splitlines(), start=1) if line.strip()]
    if len(lines) > 1 and lines[0][1].rstrip().endswith("}"):
        return [_parsed(f"{path}, line {i}", line) for i, line in lines]
    content = _parsed(str(path), text)
    if not isinstance(content, dict) or content.get("type") != "FeatureCollection":
        raise DatasetError(f"{path}: not a GeoJSON FeatureCollection; export the layer as GeoJSON")
    crs = str(content.get("crs") or "")
    if crs and not any(name in crs.replace("::", ":").replace(" ", "").upper() for name in _GLOBAL_CRS):
        raise DatasetError(f"{path}: coordinates of {crs[:80]}; export the layer in WGS 84 (EPSG:4326)")
    features = content.get("features")
    return features if isinstance(features, list) else []


def _parsed(where: str, text: str) -> Any:
    try:
        return parse_json(text)
    except ValueError as error:
        raise DatasetError(f"{where}: not JSON ({error}); the file may be truncated, export the layer again") from error
