"""Objects of a map in GeoJSON (RFC 7946): its points, longitude before latitude."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from logs.container.json_text import parse_json
from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects, check_degrees, distinct
from logs.importers.maps.object_table import CLASS_NAMES, ID_NAMES, UNKNOWN
from logs.importers.text_files import read_source_text

_MAX_KIND_LENGTH = 30
_GLOBAL_CRS = ("CRS84", "4326", "WGS84", "4979")


def read_geojson(path: Path) -> MapObjects:
    """Read the points of a FeatureCollection, or of features of which each has a line.

    Args:
        path: the file, packed by gzip or not.

    Raises:
        DatasetError: no GeoJSON, no point in it, coordinates that are no degrees, or no such property.
    """
    source = read_source_text(path)
    positions, labels, ids, others = list[list[float]](), list[str](), list[str](), Counter[str]()
    for number, feature in enumerate(_features(path, source.text), start=1):
        geometry, properties = _part(feature, "geometry"), _part(feature, "properties")
        kind = geometry.get("type")
        if kind not in ("Point", "MultiPoint"):
            others[kind[:_MAX_KIND_LENGTH] if isinstance(kind, str) else "without geometry"] += 1
            continue
        label = _first(properties, CLASS_NAMES) or UNKNOWN
        name = str(feature.get("id") or _first(properties, ID_NAMES) or number)
        coordinates = geometry.get("coordinates")
        points = coordinates if kind == "MultiPoint" else [coordinates]
        for part, point in enumerate(points if isinstance(points, list) else []):
            positions.append(_position(path, number, point))
            labels.append(label)
            ids.append(name if part == 0 else f"{name}/{part}")
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
    if others and not positions:
        raise DatasetError(f"{path}: none of its features is a point ({kinds}); export points, for example centroids")
    geodetic = np.array(positions).reshape(-1, 3)
    check_degrees(str(path), geodetic)
    notes = (f"{others.total()} features that are not points were ignored ({kinds})",) if others else ()
    return MapObjects(str(path), geodetic, tuple(labels), distinct(ids), True, source.sha256, notes)


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
    if len(lines) > 1 and _is_feature(lines[0][1]):
        return [_parsed(path, line, first_line=i) for i, line in lines]
    content = _parsed(path, text)
    if not isinstance(content, dict) or content.get("type") != "FeatureCollection":
        raise DatasetError(f"{path}: no GeoJSON FeatureCollection; export the layer as GeoJSON")
    crs = str(content.get("crs") or "")
    if crs and not any(name in crs.replace("::", ":").replace(" ", "").upper() for name in _GLOBAL_CRS):
        raise DatasetError(f"{path}: coordinates of {crs[:80]}; export the layer in WGS 84 (EPSG:4326)")
    features = content.get("features")
    return features if isinstance(features, list) else []


def _is_feature(line: str) -> bool:
    try:
        content = parse_json(line)
    except ValueError:
        return False
    return isinstance(content, dict) and content.get("type") == "Feature"


def _parsed(path: Path, text: str, *, first_line: int = 1) -> Any:
    try:
        return parse_json(text)
    except json.JSONDecodeError as error:
        line = first_line + error.lineno - 1
        raise DatasetError(
            f"{path}, line {line}: not JSON ({error.msg}, character {error.colno}); the file may be cut off"
        ) from error
    except ValueError as error:
        raise DatasetError(
            f"{path}: nested too deeply, or numbers too long ({error}); export the layer again"
        ) from error


def _first(properties: Mapping[str, Any], names: tuple[str, ...]) -> str:
    lower = {key.lower(): value for key, value in properties.items()}
    return next((str(lower[name.lower()]) for name in names if lower.get(name.lower()) not in (None, "")), "")
