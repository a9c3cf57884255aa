"""Several imported maps as one."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import SavedMapError
from slam.common.geometry import apply
from slam.place_recognition.imported_map import ImportedMap, make_imported_map

SAME_SIGMAS = 2.0
"""Objects of two maps are one if they are that near, in standard deviations of their difference: 86 % are."""


def merge_imported_maps(first: ImportedMap, second: ImportedMap) -> ImportedMap:
    """The objects of both in the frame of the first; mutual nearest neighbours of one class are one object.

    Raises:
        SavedMapError: one of them is not georeferenced.
    """
    if first.georeference is None or second.georeference is None:
        raise SavedMapError("imported maps are joined by their georeferences; import both with --origin")
    T_first_second = first.georeference.T_map_other(second.georeference)
    here, there = first.objects, second.objects
    others = apply(T_first_second, there.positions)
    radius_m = SAME_SIGMAS * float(np.hypot(first.sigma_m, second.sigma_m))
    labels, other_labels = list(here.labels), list(there.labels)
    duplicates = _duplicates(here.positions, labels, others, other_labels, radius_m)
    new = np.setdiff1d(np.arange(len(second)), duplicates)
    ids, known = list(here.ids), set(here.ids)
    for row in new.tolist():
        unused = there.ids[row]
        while unused in known:
            unused += "'"
        known.add(unused)
        ids.append(unused)
    return make_imported_map(
        np.concatenate([here.positions, others[new]]),
        [*labels, *(other_labels[row] for row in new)],
        ids,
        sigma_m=max(first.sigma_m, second.sigma_m),
        georeference=first.georeference,
        source={key: first.metadata[key] for key in ("source", "input_sha256", "version") if key in first.metadata},
    )


def _duplicates(
    positions: FloatArray, labels: list[str], others: FloatArray, other_labels: list[str], radius_m: float
) -> IntArray:
    """Rows (K,) of ``others`` that are the same object as one of ``positions``."""
    found = list[int]()
    kinds, other_kinds = np.array(labels), np.array(other_labels)
    for label in np.intersect1d(kinds, other_kinds):
        mine, theirs = np.flatnonzero(kinds == label), np.flatnonzero(other_kinds == label)
        tree, other_tree = cKDTree(positions[mine, :2]), cKDTree(others[theirs, :2])
        distances_m, nearest = tree.query(others[theirs, :2])
        back = other_tree.query(positions[mine, :2])[1]
        same = (distances_m <= radius_m) & (np.asarray(back)[nearest] == np.arange(len(theirs)))
        found += theirs[same].tolist()
    return np.array(found, dtype=np.int64)
