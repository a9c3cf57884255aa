"""A labelled cloud of a whole place -> the objects of a map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from logs.clouds.cloud_files import read_points
from logs.clouds.labelled_cloud import labelled_cloud
from logs.clouds.objects import find_objects
from logs.digest import file_sha256
from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects


def read_cloud_map(path: Path, names: Mapping[int, str] | None = None) -> MapObjects:
    """Objects in a PLY file of the classes in ``names``, or, without it, of all but 0, named by their numbers.

    Raises:
        DatasetError: the file cannot be read, or holds no labels, fewer than four objects, or points too far apart.
    """
    cloud = labelled_cloud(read_points(path), str(path))
    try:
        found = find_objects(cloud, names)
    except DatasetError as error:
        raise DatasetError(f"{path}: {error}") from error
    if len(found.labels) < 4:
        numbers = np.unique(cloud.classes).tolist()
        raise DatasetError(
            f"{path}: {len(found.labels)} objects; a map needs at least four. The classes of its points: "
            f"{', '.join(map(str, numbers[:10])) or 'none'}{', ...' if len(numbers) > 10 else ''}"
        )
    instances = found.instances.tolist()
    ids = tuple(f"{i}" if instance == 0 else f"{instance}:{i}" for i, instance in enumerate(instances))
    return MapObjects(str(path), found.positions, found.labels, ids, False, file_sha256(path))
