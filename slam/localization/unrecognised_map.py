"""Why a robot was probably not found in its map: what a user can change, in one line.

The most telling reasons come first. One of them is a mirror image: plane coordinates come as (x, y) = (east, north)
from some sources and as (north, east) from others, as geodesists write them. Taken the wrong way round they are a
mirror image, which no motion of the robot explains.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from logs.messages import GeodeticFix, ObjectMapRecord, TrajectoryRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply
from slam.localization.prior_map import PriorMap
from slam.object_map.submap import Submap
from slam.place_recognition.imported_map import ImportedMap
from slam.place_recognition.place_search import VOTE_SIGMAS as TOLERANCE_SIGMAS

MOST_LANDMARKS = 60
FEWEST_LANDMARKS = 4
"""Fewer do not distinguish places."""
FEWEST_MET = 8
PLACES = 5
FAR_M = 1000.0
"""Farther from all objects of a map no robot is that sees them."""
NAMED = 5
"""Classes that are listed."""

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
    if far_m > FAR_M:
        return (
            f"the fixes of the log are {far_m / 1000.0:.0f} km from the nearest object, so the map is of another place"
        )
    seen, labels = _landmarks_of_drive(objects, trajectory)
    theirs = tuple(known.vocabulary if isinstance(known, ImportedMap) else sorted(_confirmed_labels(known.objects)))
    shared = np.isin(labels, theirs)
    if len(labels) and not shared.any():
        return (
            f"no class in common: the map has {_listed(theirs)}, the drive {_listed(sorted(set(labels)))}; rename them "
            "in [labels]"
        )
    if shared.sum() < FEWEST_LANDMARKS:
        return f"{shared.sum()} landmarks of a class of the map were seen, too few for a relocalization; drive farther"
    if not isinstance(known, ImportedMap):
        return f"no place of the map fits the {shared.sum()} landmarks: the map is of another place, or is outdated"
    nearest = np.argsort(np.linalg.norm(seen[shared][:, :2], axis=1), kind="stable")[:MOST_LANDMARKS]
    return _why_not_in_imported(known, seen[shared][nearest], np.array(labels)[shared][nearest], sigma_m)


def why_doubtful(known: PriorMap, objects: ObjectMapRecord, trajectory: TrajectoryRecord, sigma_m: float) -> str:
    """Why a drive was probably relocalized at a wrong place of a map; "" without evidence of it.

    Crossings that look alike are found in a mirrored map, too. What matched nothing there then fits the mirror image.
    """
    if not isinstance(known, ImportedMap):
        return ""
    seen, labels = _landmarks_of_drive(objects, trajectory)
    shared = np.isin(labels, known.vocabulary)
    nearest = np.argsort(np.linalg.norm(seen[shared][:, :2], axis=1), kind="stable")[:MOST_LANDMARKS]
    if len(nearest) < FEWEST_MET:
        return ""
    positions, classes, spread_m = _in_map(known, seen[shared][nearest], np.array(labels)[shared][nearest], sigma_m)
    met = _met(known, positions, classes, spread_m)
    return MIRRORED if _is_mirrored(known, positions, classes, spread_m, met) else ""


def _in_map(
    known: ImportedMap, positions: FloatArray, names: np.ndarray, sigma_m: float
) -> tuple[FloatArray, IntArray, float]:
    """Landmarks (N, 3) m with their classes (N,) as the map counts them, and the deviation of both together."""
    number_of = {name: number for number, name in enumerate(known.vocabulary)}
    classes = np.array([number_of[name] for name in names.tolist()], dtype=np.int64)
    return positions, classes, float(np.hypot(sigma_m, known.sigma_m))


def _is_mirrored(known: ImportedMap, positions: FloatArray, labels: IntArray, spread_m: float, met: int) -> bool:
    """Whether landmarks, of which ``met`` meet an object as they are, meet most once x and y change places."""
    swapped = _met(known, positions[:, [1, 0, 2]], labels, spread_m)
    return swapped >= max(FEWEST_MET, len(labels) // 2, 2 * met)


def _why_not_in_imported(known: ImportedMap, positions: FloatArray, names: np.ndarray, sigma_m: float) -> str:
    """The reason by where landmarks (N, 3) m of the drive, whose classes are ``names`` (N,), fit best."""
    positions, labels, spread_m = _in_map(known, positions, names, sigma_m)
    met = _met(known, positions, labels, spread_m)
    if _is_mirrored(known, positions, labels, spread_m, met):
        return MIRRORED
    where = f"at the best place {met} of {len(labels)} landmarks meet an object of their class"
    if 2 * met > len(labels):
        return f"{where}, no better than chance among {len(known)} objects; drive farther, or give the place by --near"
    return f"{where}: the map is of another place, outdated, or not in metres"


def _landmarks_of_drive(objects: ObjectMapRecord, trajectory: TrajectoryRecord) -> tuple[FloatArray, list[str]]:
    """Positions (N, 3) m, from where the drive began, and classes of the landmarks that the drive itself has seen."""
    if not len(trajectory.stamps_ns):
        return np.zeros((0, 3)), []
    is_own = (objects.first_seen_ns >= trajectory.stamps_ns[0]) & (np.array(objects.states) == "confirmed")
    rows = np.flatnonzero(is_own)
    labels = objects.labels
    return objects.positions[rows] - trajectory.T_map_body[0, :3, 3], [labels[row] for row in rows.tolist()]


def _confirmed_labels(objects: ObjectMapRecord) -> set[str]:
    return {label for label, state in zip(objects.labels, objects.states, strict=True) if state == "confirmed"}


def _distance_of_fixes(known: PriorMap, fixes: Sequence[GeodeticFix]) -> float:
    """Distance [m] of the median of the fixes from the nearest object of the map; 0 if it is unknown."""
    if not isinstance(known, ImportedMap) or known.georeference is None or not fixes:
        return 0.0
    geodetic = np.array([[fix.latitude_deg, fix.longitude_deg, fix.altitude_m] for fix in fixes])
    place = np.median(known.georeference.to_map(geodetic)[:, :2], axis=0)
    return float(np.linalg.norm(known.positions[:, :2] - place, axis=1).min())


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} others" if len(names) > NAMED else "")


def _met(imported: ImportedMap, positions: FloatArray, labels: IntArray, sigma_m: float) -> int:
    """Number of landmarks that match an object of their class, at the best of their likeliest poses."""
    seen = Submap(positions, np.full(len(labels), sigma_m), labels, np.arange(len(labels)))
    poses = imported.search().find_poses(seen, count=PLACES)
    tolerance_m = TOLERANCE_SIGMAS * sigma_m
    best = 0
    for T_map_query in poses:
        moved = apply(T_map_query, positions)
        middle = moved[:, :2].mean(axis=0)
        near = imported.near(middle, float(np.abs(moved[:, :2] - middle).max()) + tolerance_m)
        count = 0
        for label in np.unique(labels).tolist():
            theirs = imported.positions[near[imported.classes[near] == label], :2]
            if len(theirs):
                count += int(np.count_nonzero(cKDTree(theirs).query(moved[labels == label, :2])[0] <= tolerance_m))
        best = max(best, count)
    return best
