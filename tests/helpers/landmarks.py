"""Landmarks and detections of them, without a drive."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from logs.messages import ObjectDetections
from slam.common.arrays import FloatArray, IntArray
from slam.frontend.input.scan import Scan
from slam.object_map.landmarks import ObjectMap


def spheres(sigma_m: float, count: int) -> FloatArray:
    """Covariances (count, 3, 3) m^2 of errors that are alike in all directions."""
    return np.tile(sigma_m**2 * np.eye(3), (count, 1, 1))


def add_landmarks(
    object_map: ObjectMap,
    positions: FloatArray,
    labels: Sequence[str] = (),
    *,
    sigma_m: float = 0.1,
    second: float = 0.0,
    scan: int = 1,
    travel_m: float = 0.0,
    segment: int = 0,
    confirmed: bool = True,
) -> IntArray:
    """The rows of new landmarks at ``positions`` (N, 3) m, trees unless ``labels`` (N,) are given."""
    rows = object_map.add(
        positions,
        spheres(sigma_m, len(positions)),
        object_map.labels.indices(tuple(labels) or ("tree",) * len(positions)),
        stamp_ns=round(second * 1e9),
        scan=scan,
        travel_m=travel_m,
        segment=segment,
    )
    if confirmed:
        object_map.confirm(rows)
    return rows


def detections_of(
    positions: ArrayLike,
    labels: Sequence[str] = (),
    *,
    stamp_ns: int = 0,
    frame_id: str = "lidar",
    scores: ArrayLike | None = None,
    covariances: FloatArray | None = None,
) -> ObjectDetections:
    """A message of detections at ``positions`` (N, 3) m: sure ones of trees unless it is said otherwise."""
    at = np.array(positions, float).reshape(-1, 3)
    count = len(at)
    sure = np.ones(count) if scores is None else np.array(scores, float)
    return ObjectDetections(stamp_ns, frame_id, at, tuple(labels) or ("tree",) * count, sure, covariances)


def scan_of(
    positions: FloatArray,
    labels: Sequence[str] = (),
    *,
    sigma_m: float = 0.1,
    stamp_ns: int = 0,
    sensor: str = "lidar",
    has_own: bool = True,
) -> Scan:
    """Detections at ``positions`` (N, 3) m, trees unless ``labels`` (N,) are given; all are used."""
    count = len(positions)
    used = np.ones(count, bool)
    names = tuple(labels) or ("tree",) * count
    covariances, shifts = spheres(sigma_m, count), np.zeros((count, 3))
    return Scan(stamp_ns, sensor, positions, covariances, names, used, used & has_own, shifts)
