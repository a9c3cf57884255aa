"""A labelled cloud of a whole place -> the objects of a map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from logs.clouds.class_names import urban_name, why_left_out
from logs.clouds.labelled_cloud import LabelledCloud
from logs.clouds.objects import find_objects
from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects

_NAMED = 10
"""Classes that a message lists."""


@dataclass(frozen=True, slots=True)
class CloudSummary:
    """What was in a cloud and what is left of it: numbers of objects and of classes, before and after, as in Table I
    of "Descriptellation" (Xing et al., 2023). ``left_out``: objects by the reason.
    """

    original: tuple[int, int]
    preprocessed: tuple[int, int]
    left_out: Mapping[str, int]


def urban_objects(cloud: LabelledCloud, source: str, sha256: str) -> tuple[MapObjects, CloudSummary]:
    """Objects of a cloud in the class tree of Paris-Lille-3D and IQmulus, preprocessed as in "Descriptellation" (V-A):
    without what moves or may move, what is unknown, bollards, and surfaces.

    Raises:
        DatasetError: fewer than four objects are left.
    """
    return _objects(cloud, source, sha256, urban_name, why_left_out)


def named_objects(
    cloud: LabelledCloud, source: str, sha256: str, names: Mapping[int, str] | None = None
) -> tuple[MapObjects, CloudSummary]:
    """Objects of any cloud: of the classes in ``names``, or, without it, of all but 0, named by their numbers.

    Raises:
        DatasetError: as :func:`urban_objects`.
    """
    if names is None:
        return _objects(cloud, source, sha256, str, lambda number: "" if number else "class 0")
    return _objects(cloud, source, sha256, names.__getitem__, lambda number: "" if number in names else "unnamed")


def _objects(
    cloud: LabelledCloud, source: str, sha256: str, name: Callable[[int], str], reason: Callable[[int], str]
) -> tuple[MapObjects, CloudSummary]:
    cloud = cloud.finite()
    numbers = np.unique(cloud.classes).tolist()
    kept = {number: name(number) for number in numbers if not reason(number)}
    try:
        found = find_objects(cloud, kept)
    except DatasetError as error:
        raise DatasetError(f"{source}: {error}") from error
    parts = Counter(_instances(cloud))
    left_out = Counter({why: 0 for number in numbers if (why := reason(number))})
    for number, count in parts.items():
        left_out[reason(number)] += count
    del left_out[""]
    if len(found.labels) < 4:
        without = ", ".join(f"{count} {why}" for why, count in sorted(left_out.items())) or "nothing"
        raise DatasetError(
            f"{source}: {len(found.labels)} objects; a map needs at least four. Left out: {without}; the classes of "
            f"its points: {', '.join(map(str, numbers[:_NAMED])) or 'none'}{', ...' if len(numbers) > _NAMED else ''}"
        )
    instances = found.instances.tolist()
    ids = tuple(f"{i}" if instance == 0 else f"{instance}:{i}" for i, instance in enumerate(instances))
    summary = CloudSummary(
        (sum(parts.values()), len(parts)), (len(found.labels), len(set(found.labels))), dict(left_out)
    )
    return MapObjects(source, found.positions, found.labels, ids, False, sha256), summary


def _instances(cloud: LabelledCloud) -> list[int]:
    """The class of each instance; of a cloud without instances, of each class once."""
    instances = cloud.instances if cloud.instances is not None else np.zeros(len(cloud.classes), dtype=np.int64)
    pairs = np.unique(np.stack([cloud.classes, instances], axis=1), axis=0)
    labelled = pairs[pairs[:, 1] != 0] if cloud.instances is not None else pairs
    return [int(number) for number in labelled[:, 0]]
