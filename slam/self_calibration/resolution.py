"""How near to one another two detections of one object are, where a detector sees it more than once in a scan.

They are a cluster: hardly any other detection of their class is up to twice as far away. And they scatter around the
object from scan to scan, whereas neighbouring objects keep their offset.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from slam.common.arrays import BoolArray
from slam.common.geometry import apply, gravity_frame
from slam.self_calibration.object_tracks import MAX_DISTANCES, SurveyScan, poses_of
from slam.self_calibration.scan_pairs import MIN_PAIRS, median_range

CLUSTERED = 1.5
"""Within twice the size of a cluster are less than so many times as many pairs as within it; in rows there are twice as
many, spread over the ground four times as many.
"""
KEPT_OFFSETS = 0.25
"""Below that share of offsets that stay, detections are of one object: of a random offset some 8 % seem to stay."""


def find_resolution(scans: Sequence[SurveyScan]) -> float:
    """Distance [m] up to which detections of a class are of one object; 0 where objects are detected once.

    ``scans``: (K) in the order of their stamps; those of more than ``MAX_DISTANCES`` are left out.
    """
    scans = [scan for scan in scans if len(scan.labels) ** 2 <= MAX_DISTANCES]
    if not scans:
        return 0.0
    # Of one class in one scan, about ``MAX_DISTANCES`` at most.
    some = scans[:: 1 + sum(len(scan.labels) ** 2 for scan in scans) // MAX_DISTANCES]
    distances = np.sort(np.concatenate([pdist(scan.positions)[pdist(scan.labels[:, None]) == 0.0] for scan in some]))
    sizes = distances[distances < 0.5 * median_range(scans)]
    within_twice = np.searchsorted(distances, 2.0 * sizes, side="right")
    excess = CLUSTERED * np.arange(1, len(sizes) + 1) - within_twice
    if excess.max(initial=0.0) <= 0.0:  # most distances are not those of clusters, whatever their size
        return 0.0
    size_m = float(sizes[np.argmax(excess)])
    stay = _offsets_that_stay(scans, size_m)
    return size_m if len(stay) >= MIN_PAIRS and stay.mean() < KEPT_OFFSETS else 0.0


def _offsets_that_stay(scans: Sequence[SurveyScan], size_m: float) -> BoolArray:
    """Whether offsets (N,) between detections of a class that are as near as ``size_m`` are the same in the next scan,
    where that has two as near.
    """
    found = [np.zeros(0, dtype=np.bool_)]
    poses = gravity_frame(poses_of(scans))
    classes_m = 1e3 * median_range(scans)
    layered = [
        np.column_stack([apply(T, scan.positions), classes_m * scan.labels])
        for T, scan in zip(poses, scans, strict=True)
    ]
    for points, later in pairwise(layered):
        near = cKDTree(points).query_pairs(size_m, output_type="ndarray")
        if len(near) == 0 or len(later) < 2:
            continue
        first, second = points[near].swapaxes(0, 1)
        offsets = second - first
        lengths = np.linalg.norm(offsets, axis=1)
        distances, rows = cKDTree(later).query(0.5 * (first + second), k=2)
        changed = np.diff(later[rows], axis=1)[:, 0]
        change = np.minimum(*(np.linalg.norm(changed + sign * offsets, axis=1) for sign in (1.0, -1.0)))
        found.append((change < 0.5 * lengths)[(distances < lengths[:, None]).all(axis=1)])
    return np.concatenate(found)
