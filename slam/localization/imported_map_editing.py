"""Parts of imported maps, and several of them as one."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from slam.common.areas import Area
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import SavedMapError
from slam.common.geometry import apply
from slam.place_recognition.imported_map import ImportedMap, make_imported_map

SAME_SIGMAS = 2.0
"""Objects of two maps are one if they are that near, in standard deviations of their difference: 86 % are."""


def crop_imported_map(imported: ImportedMap, area: Area) -> ImportedMap:
    """The objects that lie in an area, where they were.

    Raises:
        SavedMapError: fewer than four lie in it.
    """
    rows = np.flatnonzero(area.contains(imported.positions.astype(np.float64)))
    if len(rows) < 4:
        low, high = imported.positions[:, :2].min(axis=0), imported.positions[:, :2].max(axis=0)
        raise SavedMapError(
            f"{len(rows)} of {len(imported)} objects lie in that area, and a map needs 4; the map extends from "
            f"({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f}) m"
        )
    objects = imported.objects
    return _made(
        imported,
        objects.positions[rows],
        [objects.labels[row] for row in rows.tolist()],
        [objects.ids[row] for row in rows.tolist()],
    )


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
    return _made(
        first,
        np.concatenate([here.positions, others[new]]),
        [*labels, *(other_labels[row] for row in new)],
        ids,
        sigma_m=max(first.sigma_m, second.sigma_m),
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


def _made(
    like: ImportedMap, positions: FloatArray, labels: list[str], ids: list[str], sigma_m: float | None = None
) -> ImportedMap:
    """A map of these objects, with the frame and the source of another."""
    return make_imported_map(
        positions,
        labels,
        ids,
        sigma_m=like.sigma_m if sigma_m is None else sigma_m,
        georeference=like.georeference,
        source={key: like.metadata[key] for key in ("source", "input_sha256", "version") if key in like.metadata},
    )
