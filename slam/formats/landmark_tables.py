"""Landmarks for other programs: a table (CSV), and places on earth (GeoJSON)."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from logs.messages import ObjectMapRecord
from logs.storage.placement import write_text
from slam.common.arrays import FloatArray
from slam.common.georeference import Georeference


def landmark_table(objects: ObjectMapRecord) -> dict[str, NDArray[np.generic]]:
    """Landmarks as named columns of equal length (M,), for example for ``pandas.DataFrame``.

    ``id``; ``label``, the likeliest class, and its ``label_probability``; ``x_m``, ``y_m``, ``z_m`` in the map frame
    and their standard deviations ``sigma_x_m``, ``sigma_y_m``, ``sigma_z_m``; ``state``; ``observations``;
    ``first_seen_ns``, ``last_seen_ns``.
    """
    sigmas = np.sqrt(np.diagonal(objects.covariances, axis1=1, axis2=2))
    return {
        "id": np.array(objects.ids, dtype=np.str_),
        "label": np.array(objects.labels, dtype=np.str_),
        "label_probability": objects.class_probabilities.max(axis=1, initial=0.0),
        **{f"{axis}_m": objects.positions[:, column] for column, axis in enumerate("xyz")},
        **{f"sigma_{axis}_m": sigmas[:, column] for column, axis in enumerate("xyz")},
        "state": np.array(objects.states, dtype=np.str_),
        "observations": objects.observation_counts,
        "first_seen_ns": objects.first_seen_ns,
        "last_seen_ns": objects.last_seen_ns,
    }


def write_csv(path: Path, objects: ObjectMapRecord) -> None:
    """Write the :func:`landmark_table`, a row a landmark.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    write_text(path, pd.DataFrame(landmark_table(objects)).to_csv(index=False, lineterminator="\n"))


def write_geojson(path: Path, objects: ObjectMapRecord, georeference: Georeference) -> None:
    """Write a point a landmark: longitude, latitude [deg] and altitude [m] on WGS 84.

    Its properties are the columns of the :func:`landmark_table` but the position.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    table = pd.DataFrame(landmark_table(objects)).drop(columns=["x_m", "y_m", "z_m"])
    write_points(path, objects.positions, table.to_dict("records"), georeference)


def write_points(
    path: Path, positions: FloatArray, properties: Iterable[Mapping[str, Any]], georeference: Georeference | None
) -> None:
    """Write points at positions (N, 3) m of a map as GeoJSON (RFC 7946): on WGS 84, or in metres of the map, whose
    place on earth is unknown.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    places = positions if georeference is None else georeference.to_geodetic(positions)[:, [1, 0, 2]]
    features = [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": place}, "properties": each}
        for each, place in zip(properties, np.round(places, 9).tolist(), strict=True)
    ]
    about = {} if georeference is not None else {"coordinates": "metres in the frame of the map"}
    write_text(path, json.dumps({"type": "FeatureCollection", "features": features, **about}, indent=1) + "\n")
