"""The frame of the detections, if it is not the one that their messages name: turned by quarter turns, as upside down
or in optical axes, or that of the body, or that of the odometry, in which the objects of a tracker stand still already.

In the right frame the detections of two scans, put into the odometry frame, lie on each other; in a wrong one they are
apart by as much as the body moved or turned in between. A frame is chosen by every other pair of scans, and it is taken
only if the scans of the other pairs agree far better in it, too.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from itertools import permutations, product

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.geometry import apply, transform_from_xyz_yaw, yaw_rad
from slam.self_calibration.object_tracks import SurveyScan, nearest_of_class_m

MOVED_SPACINGS = 0.25
"""Between two scans that are compared, objects seem to move by that share of their spacing if all is right."""
BETTER = 0.5
"""A correction brings the scans nearer to one another by that factor at least."""
PAIRS = 300
MIN_PAIRS = 40

_Pairs = list[tuple[int, int]]


def agree(scans: Sequence[SurveyScan]) -> bool:
    """Whether scans (K) lie on one another nearer than the body moved in between; so do scans that cannot tell."""
    if not scans:
        return True
    spacing_m = spacing_of(scans)
    apart_m = _apart(scans, _pairs_apart(scans, spacing_m), np.eye(3), spacing_m)
    return not np.isfinite(apart_m) or apart_m < BETTER * MOVED_SPACINGS * spacing_m


def better_frame(as_they_are: Sequence[SurveyScan], others: Mapping[str, Sequence[SurveyScan]]) -> str | None:
    """The name of another frame in which the scans agree far better, or None."""
    found = {name: scans for name, scans in others.items() if scans}
    if not found or not as_they_are:
        return None
    spacing_m = min(spacing_of(scans) for scans in (as_they_are, *found.values()))

    def apart_m(scans: Sequence[SurveyScan], part: int) -> float:
        return _apart(scans, _pairs_apart(scans, spacing_m)[part::2], np.eye(3), spacing_m)

    best = min(found, key=lambda name: apart_m(found[name], 0))
    return best if all(apart_m(found[best], part) < BETTER * apart_m(as_they_are, part) for part in (0, 1)) else None


def find_orientation(scans: Sequence[SurveyScan], headings_rad: FloatArray) -> FloatArray:
    """Rotation (3, 3) of detections, in the axes of the body, that makes scans agree; the identity where none is found.

    Args:
        scans: (K) in the order of their stamps.
        headings_rad: (K,) of the body, continuous.
    """
    spacing_m = spacing_of(scans)
    moved_m = MOVED_SPACINGS * spacing_m
    groups = _pairs_by_travel(scans, moved_m), _pairs_by_turn(headings_rad, moved_m / max(_median_range(scans), 1e-9))
    if min(len(group) for group in groups) < MIN_PAIRS:
        return np.eye(3)

    def apart_m(R: FloatArray, part: int, most: float = np.inf) -> float:
        total = 0.0
        for group in groups:
            if total < most:  # else it is worse already
                total += _apart(scans, group[part::2], R, spacing_m)
        return total

    best, least = np.eye(3), BETTER * apart_m(np.eye(3), 0)
    for R in _quarter_turns()[1:]:
        found = apart_m(R, 0, least)
        if found < least:
            best, least = R, found
    return best if apart_m(best, 1) < BETTER * apart_m(np.eye(3), 1) else np.eye(3)


def roll_pitch_yaw_deg(R: FloatArray) -> FloatArray:
    """Angles (3,) about the fixed axes x, y, z, in this order."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # one of the angles may be chosen then, and is 0
        return np.asarray(Rotation.from_matrix(R).as_euler("xyz", degrees=True)) + 0.0


def spacing_of(scans: Sequence[SurveyScan]) -> float:
    """Median distance [m] of a detection from the nearest of its class in its scan, in space; at most its range."""
    some = scans[:: max(len(scans) // (2 * PAIRS), 1)]
    nearest = [nearest_of_class_m(scan.positions, scan.labels) for scan in some]
    return min(float(np.median(np.concatenate(nearest))), _median_range(scans))


def _quarter_turns() -> list[FloatArray]:
    """The 24 rotations (3, 3) that map axes to axes, the identity first."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[np.arange(3), order] = signs
        if np.linalg.det(R) > 0.0:
            found.append(R)
    return found


def _median_range(scans: Sequence[SurveyScan]) -> float:
    return float(np.median(np.concatenate([np.linalg.norm(scan.positions, axis=1) for scan in scans])))


def _pairs_apart(scans: Sequence[SurveyScan], spacing_m: float) -> _Pairs:
    """Pairs of scans between which the body went somewhere, and did not only tremble."""
    moved_m = MOVED_SPACINGS * spacing_m
    return [
        (first, second)
        for first, second in _pairs_by_travel(scans, moved_m)
        if 2.0 * np.linalg.norm((scans[second].T_odom_body - scans[first].T_odom_body)[:2, 3]) > moved_m
    ]


def _pairs_by_travel(scans: Sequence[SurveyScan], moved_m: float) -> _Pairs:
    """Pairs of scans with just so much travel in between, evenly over the drive."""
    positions = np.stack([scan.T_odom_body[:2, 3] for scan in scans])
    travel_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    return _evenly(_reached(travel_m, moved_m))


def _pairs_by_turn(headings_rad: FloatArray, least_rad: float) -> _Pairs:
    """Pairs of scans between which the body turns most for the time, evenly over the drive."""
    turn_rad = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(headings_rad)))])
    pairs = _reached(turn_rad, least_rad)
    rates = np.array([(turn_rad[second] - turn_rad[first]) / (second - first) for first, second in pairs])
    fastest = np.argsort(-rates, kind="stable")[: max(len(pairs) // 4, PAIRS)]
    return _evenly([pairs[index] for index in np.sort(fastest)])


def _reached(way: FloatArray, least: float) -> _Pairs:
    """Pairs (i, j) with j the first scan after i to which the way from i is ``least``."""
    second = np.searchsorted(way, way + least)
    return [(first, int(after)) for first, after in enumerate(second) if first < after < len(way)]


def _evenly(pairs: _Pairs) -> _Pairs:
    chosen = np.linspace(0, max(len(pairs) - 1, 0), min(PAIRS, len(pairs))).astype(np.int64)
    return [pairs[index] for index in np.unique(chosen)]


def _apart(scans: Sequence[SurveyScan], pairs: _Pairs, R: FloatArray, limit_m: float) -> float:
    """Median distance [m] of detections from the nearest of their class in the other scan of a pair, in the odometry
    frame, at most ``limit_m``; detections are turned by R (3, 3) first. NaN where too few pairs tell.
    """
    if 2 * len(pairs) < MIN_PAIRS:
        return float("nan")
    found = []
    for first, second in pairs:
        # Classes lie on layers that are farther apart than the limit.
        points, reference = (
            np.column_stack([apply(_upright(scan), scan.positions @ R.T), 10.0 * limit_m * scan.labels])
            for scan in (scans[first], scans[second])
        )
        distances, _ = cKDTree(reference).query(points, distance_upper_bound=limit_m)
        found.append(np.minimum(distances, limit_m))
    return float(np.median(np.concatenate(found)))


def _upright(scan: SurveyScan) -> FloatArray:
    return transform_from_xyz_yaw(scan.T_odom_body[:3, 3], yaw_rad(scan.T_odom_body))
