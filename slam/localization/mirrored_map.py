"""Whether a map in which a robot was not found fits what it saw once x and y change places.

Plane coordinates come as (x, y) = (east, north) from some sources and as (north, east) from others, as geodesists write
them. Taken the wrong way round they are a mirror image, which no motion of the robot explains.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from logs.messages import ObjectMapRecord, TrajectoryRecord
from slam.common.arrays import FloatArray, IntArray
from slam.place_recognition.imported_map import ImportedMap
from slam.place_recognition.quad_index import TOLERANCE_SIGMAS, QuadMatches
from slam.place_recognition.triangle_voting import vote_for_poses

MOST_LANDMARKS = 60
FEWEST_MET = 8
PLACES = 5


def is_mirrored(imported: ImportedMap, objects: ObjectMapRecord, trajectory: TrajectoryRecord, sigma_m: float) -> bool:
    """Whether most landmarks of a drive meet objects of the map that is mirrored, and not of the map as it is.

    Args:
        imported: the map.
        objects: of the drive, in a frame of its own; those of the map among them were seen at time 0.
        trajectory: in the frame of ``objects``.
        sigma_m: standard deviation of a coordinate of a landmark.
    """
    number_of = {name: number for number, name in enumerate(imported.vocabulary)}
    confirmed = [
        row
        for row, (state, label) in enumerate(zip(objects.states, objects.labels, strict=True))
        if state == "confirmed" and objects.first_seen_ns[row] > 0 and label in number_of
    ]
    if len(confirmed) < FEWEST_MET or not len(trajectory.T_map_body):
        return False
    positions = objects.positions[confirmed] - trajectory.T_map_body[0, :3, 3]
    labels = np.array([number_of[objects.labels[row]] for row in confirmed], dtype=np.int64)
    nearest = np.argsort(np.linalg.norm(positions[:, :2], axis=1), kind="stable")[:MOST_LANDMARKS]
    positions, labels = positions[nearest], labels[nearest]
    spread_m = float(np.hypot(sigma_m, imported.sigma_m))
    mirrored = _met(imported, positions[:, [1, 0, 2]], labels, spread_m)
    return mirrored >= max(FEWEST_MET, len(labels) // 2, 2 * _met(imported, positions, labels, spread_m))


def _met(imported: ImportedMap, positions: FloatArray, labels: IntArray, sigma_m: float) -> int:
    """How many of the landmarks meet an object of their class, at the best of the poses that their quads propose."""
    matches = imported.quads.match(positions, labels, imported.positions, sigma_m=sigma_m)
    rows, corners = np.unique(matches.reference, return_inverse=True)
    if not len(rows):
        return 0
    tolerance_m = TOLERANCE_SIGMAS * sigma_m
    poses = vote_for_poses(
        positions,
        imported.positions[rows].astype(np.float64),
        QuadMatches(matches.query, corners.reshape(-1, 4)),
        tolerance_m=tolerance_m,
        count=PLACES,
    )
    best = 0
    for pose in poses:
        moved = positions @ pose.T_reference_query[:3, :3].T + pose.T_reference_query[:3, 3]
        middle = moved[:, :2].mean(axis=0)
        near = imported.near(middle, float(np.abs(moved[:, :2] - middle).max()) + tolerance_m)
        count = 0
        for label in np.unique(labels).tolist():
            theirs = imported.positions[near[imported.classes[near] == label], :2]
            if len(theirs):
                count += int(np.count_nonzero(cKDTree(theirs).query(moved[labels == label, :2])[0] <= tolerance_m))
        best = max(best, count)
    return best
