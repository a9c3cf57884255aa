"""A labelled cloud of a whole place -> the objects of a map."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from logs.clouds.labelled_cloud import LabelledCloud
from logs.clouds.objects import find_objects
from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects


def map_of_cloud(cloud: LabelledCloud, source: str, sha256: str, names: Mapping[int, str] | None = None) -> MapObjects:
    """Objects of the classes in ``names``, or, without it, of all but 0, named by their numbers.

    Raises:
        DatasetError: fewer than four objects, or points too far apart.
    """
    try:
        found = find_objects(cloud, names)
    except DatasetError as error:
        raise DatasetError(f"{source}: {error}") from error
    if len(found.labels) < 4:
        numbers = np.unique(cloud.classes).tolist()
        raise DatasetError(
            f"{source}: {len(found.labels)} objects; a map needs at least four. The classes of its points: "
            f"{', '.join(map(str, numbers[:10])) or 'none'}{', ...' if len(numbers) > 10 else ''}"
        )
    instances = found.instances.tolist()
    ids = tuple(f"{i}" if instance == 0 else f"{instance}:{i}" for i, instance in enumerate(instances))
    return MapObjects(source, found.positions, found.labels, ids, False, sha256)
