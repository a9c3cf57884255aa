"""Whether poses and scans belong together: what stands still does not move with the robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist

from logs.errors import DatasetError
from logs.messages import FloatArray, ObjectDetections

MAX_SHARE = 0.15
"""Share of the motion between two scans by which all objects may move along: a sensor turned by 9 deg gives as much."""
REACH = 2.5
"""How far objects are followed, in ways driven: under a sensor that is turned by 180 deg they move by 2, and noise."""
MIN_STEPS = 10
MIN_OBJECTS = 3


def check_poses(detections: Sequence[ObjectDetections], T_odom_body: FloatArray, files: str) -> None:
    """See that objects stand still in the frame of the poses.

    Objects of one scan and the next, nearest to one another among those of their class, move by what is wrong with the
    poses: their median displacement, summed over the scans, is a share of the way driven.

    Args:
        detections: of N scans, in the body frame.
        T_odom_body: (N, 4, 4).
        files: names of the files that make the poses, for the message.

    Raises:
        DatasetError: the objects move along; tells by how much.
    """
    moved_m, driven_m = [], []
    for i in range(len(detections) - 1):
        shift = T_odom_body[i + 1, :3, 3] - T_odom_body[i, :3, 3]
        here, there = (_by_class(detections[k], T_odom_body[k]) for k in (i, i + 1))
        pairs = [_displacements(here[label], there[label], shift) for label in sorted(here.keys() & there.keys())]
        displacements = np.concatenate([np.zeros((0, 3)), *pairs])
        if len(displacements) >= MIN_OBJECTS:
            moved_m.append(float(np.linalg.norm(np.median(displacements, axis=0))))
            driven_m.append(float(np.linalg.norm(shift)))
    if len(moved_m) < MIN_STEPS or sum(driven_m) == 0.0:
        return
    share = sum(moved_m) / sum(driven_m)
    if share > MAX_SHARE:
        raise DatasetError(
            f"{files} do not fit the scans: objects that stand still move by {np.mean(moved_m):.2f} m from scan to "
            f"scan ({100.0 * share:.0f} % of the {np.mean(driven_m):.2f} m driven); give calibration and poses of this "
            "sequence"
        )


def _by_class(detections: ObjectDetections, T_odom_body: FloatArray) -> dict[str, FloatArray]:
    places = detections.positions @ T_odom_body[:3, :3].T + T_odom_body[:3, 3]
    labels = np.array(detections.labels, dtype=object)
    return {str(label): places[labels == label] for label in set(detections.labels)}


def _displacements(here: FloatArray, there: FloatArray, shift: FloatArray) -> FloatArray:
    """Displacements (K, 3) m of mutually nearest objects that no others are near enough to be mistaken for."""
    reach_m = REACH * float(np.linalg.norm(shift))
    distances = cdist(here, there)  # (here, there)
    nearest, back = distances.argmin(axis=1), distances.argmin(axis=0)
    rows = np.arange(len(here))
    spacing = np.sort(cdist(here, here), axis=1)[:, 1] if len(here) > 1 else np.full(len(here), np.inf)
    is_sure = (back[nearest] == rows) & (distances[rows, nearest] <= reach_m) & (spacing > 2.0 * reach_m)
    moved: FloatArray = there[nearest[is_sure]] - here[is_sure]
    return moved
