"""Landmarks for other programs: a table (CSV), places on earth (GeoJSON), points (PLY)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from logs.messages import ObjectMapRecord
from logs.scene import class_color
from logs.storage.placement import write_text
from slam.common.errors import InputDataError
from slam.common.georeference import Georeference

_DEGREES = 9  # a tenth of a millimetre


def write_csv(path: Path, objects: ObjectMapRecord) -> None:
    """Write a row a landmark: id, class and its probability, position and standard deviations [m], observations.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    sigmas = np.sqrt(np.diagonal(objects.covariances, axis1=1, axis2=2))
    table = pd.DataFrame(
        {
            "id": objects.ids,
            "class": objects.labels,
            "probability": objects.class_probabilities.max(axis=1, initial=0.0),
            **{f"{axis}_m": objects.positions[:, column] for column, axis in enumerate("xyz")},
            **{f"sigma_{axis}_m": sigmas[:, column] for column, axis in enumerate("xyz")},
            "observations": objects.observation_counts,
        }
    )
    write_text(path, table.to_csv(index=False, lineterminator="\n"))


def write_geojson(path: Path, objects: ObjectMapRecord, georeference: Georeference) -> None:
    """Write a point a landmark: longitude, latitude [deg] and altitude [m] on WGS 84 (RFC 7946).

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    places = georeference.to_geodetic(objects.positions).tolist()
    features = [
        {
            "type": "Feature",
            "id": name,
            "geometry": {
                "type": "Point",
                "coordinates": [round(longitude, _DEGREES), round(latitude, _DEGREES), round(altitude_m, 3)],
            },
            "properties": {"class": label, "observations": count},
        }
        for name, label, count, (latitude, longitude, altitude_m) in zip(
            objects.ids, objects.labels, objects.observation_counts.tolist(), places, strict=True
        )
    ]
    write_text(path, json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n")


def write_ply(path: Path, objects: ObjectMapRecord) -> None:
    """Write a coloured vertex a landmark, in text; the class is an index into the comments of the header.

    Raises:
        InputDataError: a class whose name has line breaks.
        UnwritableLogError: the file cannot be written.
    """
    labels = objects.labels
    classes = sorted(set(labels))
    if any(len(name.splitlines()) > 1 for name in classes):
        raise InputDataError("a class has a name of several lines, which a PLY file cannot hold")
    lines = ["ply", "format ascii 1.0", *(f"comment class {i} {ascii(name)[1:-1]}" for i, name in enumerate(classes))]
    lines += [f"element vertex {len(labels)}", *(f"property double {axis}" for axis in "xyz")]
    lines += [*(f"property uchar {color}" for color in ("red", "green", "blue")), "property int class", "end_header"]
    for (x, y, z), label in zip(objects.positions.tolist(), labels, strict=True):
        red, green, blue = (round(255 * part) for part in class_color(label)[:3])
        lines.append(f"{x!r} {y!r} {z!r} {red} {green} {blue} {classes.index(label)}")
    write_text(path, "\n".join(lines) + "\n")
