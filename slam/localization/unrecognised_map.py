"""Why a robot was probably not found in its map: what a user can change, in one line.

The most telling reasons come first. One of them is a mirror image: plane coordinates come as (x, y) = (east, north)
from some sources and as (north, east) from others, as geodesists write them. Taken the wrong way round they are a
mirror image, which no motion of the robot explains.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from logs.messages import GeodeticFix, ObjectMapRecord, TrajectoryRecord
from slam.common.arrays import FloatArray
from slam.localization.gnss import geodetic_places
from slam.localization.prior_map import PriorMap
from slam.object_map.submap import Submap
from slam.place_recognition.imported_map import ImportedMap

MIN_LANDMARKS = 4
"""Fewer do not distinguish places."""
MIN_MET = 8
"""Landmarks that meet an object by which a mirror image is told from chance."""

MIRRORED = "the map is mirrored: the landmarks fit with x and y exchanged; import it with these columns swapped"


def why_not_recognised(
    known: PriorMap,
    objects: ObjectMapRecord,
    trajectory: TrajectoryRecord,
    sigma_m: float,
    fixes: Sequence[GeodeticFix] = (),
) -> str:
    """The likeliest reason that a drive was not found in a map.

    Args:
        known: the map.
        objects: of the drive, in a frame of its own, those that were taken from the map among them.
        trajectory: in the frame of ``objects``.
        sigma_m: standard deviation of a coordinate of a landmark.
        fixes: of satellites.
    """
    far_m = _distance_of_fixes(known, fixes)
    if far_m > 1000.0:  # farther than any sensor reaches
        return (
            f"the fixes of the log are {far_m / 1000.0:.0f} km from the nearest object, so the map is of another place"
        )
    (_, labels), theirs = _own_landmarks(objects, trajectory), known.vocabulary
    if labels and set(labels).isdisjoint(theirs):
        return (
            f"no class in common: the map has {_listed(theirs)}, the drive {_listed(sorted(set(labels)))}; rename them "
            "in [labels]"
        )
    shared = sum(label in theirs for label in labels)
    if shared < MIN_LANDMARKS:
        return f"{shared} landmarks of a class of the map were seen, too few for a relocalization; drive farther"
    if not isinstance(known, ImportedMap):
        return f"no place of the map fits the {shared} landmarks: the map is of another place, or is outdated"
    seen = _nearest_landmarks(known, objects, trajectory, sigma_m)
    met, is_mirrored = _fit(known, seen)
    if is_mirrored:
        return MIRRORED
    where = f"at the best place {met} of {len(seen)} landmarks meet an object of their class"
    if 2 * met > len(seen):
        return f"{where}, no better than chance among {len(known)} objects; drive farther, or give the place by --near"
    return f"{where}: the map is of another place, outdated, or not in metres"


def why_doubtful(known: PriorMap, objects: ObjectMapRecord, trajectory: TrajectoryRecord, sigma_m: float) -> str:
    """Why a drive was probably relocalized at a wrong place of a map; "" without evidence of it.

    Crossings that look alike are found in a mirrored map, too. What matched nothing there then fits the mirror image.
    """
    if not isinstance(known, ImportedMap):
        return ""
    seen = _nearest_landmarks(known, objects, trajectory, sigma_m)
    return MIRRORED if _fit(known, seen)[1] else ""


def _fit(known: ImportedMap, seen: Submap) -> tuple[int, bool]:
    """How many landmarks meet an object of their class, and whether most meet one once x and y change places."""
    search = known.search()
    met, swapped = (
        max(search.count_met(each, search.find_poses(each, count=5)).tolist(), default=0)
        for each in (seen, replace(seen, positions=seen.positions[:, [1, 0, 2]]))
    )
    return met, swapped >= max(MIN_MET, len(seen) // 2, 2 * met)


def _own_landmarks(objects: ObjectMapRecord, trajectory: TrajectoryRecord) -> tuple[FloatArray, list[str]]:
    """Positions (N, 3) m and labels of the confirmed landmarks that the drive itself has seen."""
    since_ns = trajectory.stamps_ns.min(initial=np.iinfo(np.int64).max)
    seen = (objects.first_seen_ns >= since_ns) & objects.is_confirmed
    return objects.positions[seen], list(compress(objects.labels, seen.tolist()))


def _nearest_landmarks(
    known: ImportedMap, objects: ObjectMapRecord, trajectory: TrajectoryRecord, sigma_m: float
) -> Submap:
    """The landmarks of the drive nearest to where it began, of classes of the map, and numbered as these are.

    Their noise includes that of the map.
    """
    number_of = {name: number for number, name in enumerate(known.vocabulary)}
    positions, own_labels = _own_landmarks(objects, trajectory)
    labels = np.array([number_of.get(label, -1) for label in own_labels], dtype=np.int64)
    is_known = labels >= 0
    positions, labels = positions[is_known] - trajectory.T_map_body[:1, :3, 3], labels[is_known]
    nearest = np.argsort(np.linalg.norm(positions[:, :2], axis=1), kind="stable")[:60]
    sigmas = np.full(len(nearest), np.hypot(sigma_m, known.sigma_m))
    return Submap(positions[nearest], sigmas, labels[nearest], nearest)


def _distance_of_fixes(known: PriorMap, fixes: Sequence[GeodeticFix]) -> float:
    """Distance [m] of the median of the fixes from the nearest object of the map; 0 if it is unknown."""
    if known.georeference is None or not fixes:
        return 0.0
    place = np.median(known.georeference.to_map(geodetic_places(fixes))[:, :2], axis=0)
    return float(np.linalg.norm(known.positions[:, :2] - place, axis=1).min())


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} others" if len(names) > 5 else "")
