"""Which way the sensor looks, if its transform is wrong by quarter turns: upside down, backwards, optical axes.

With the right orientation the detections of two scans, put into the odometry frame, lie on each other; with a wrong
one they are apart by as much as the body moved or turned in between. Each of the 24 rotations that map axes to axes is
tried on pairs of scans with enough travel and on pairs with enough turn, since some show only in turns.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
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
PAIRS = 150
LEAST_PAIRS = 20


def find_orientation(scans: Sequence[SurveyScan], headings_rad: FloatArray) -> FloatArray:
    """Rotation (3, 3) of detections, in the axes of the body, that makes scans agree; the identity where none is found.

    Args:
        scans: (K) in the order of their stamps.
        headings_rad: (K,) of the body, continuous.
    """
    range_m = _median_range(scans)
    spacing_m = spacing_of(scans)
    moved_m = MOVED_SPACINGS * spacing_m
    groups = pairs_by_travel(scans, moved_m), _pairs_by_turn(headings_rad, moved_m / max(range_m, 1e-9))
    if min(len(group) for group in groups) < LEAST_PAIRS:
        return np.eye(3)
    rotations = _quarter_turns()
    as_it_is = sum(distance_of_nearest(scans, group, rotations[0], spacing_m) for group in groups)
    best, least = np.eye(3), BETTER * as_it_is
    for R in rotations[1:]:
        apart = 0.0
        for group in groups:
            if apart < least:  # else it is worse already
                apart += distance_of_nearest(scans, group, R, spacing_m)
        if apart < least:
            best, least = R, apart
    return best


def roll_pitch_yaw_deg(R: FloatArray) -> FloatArray:
    """Angles (3,) about the fixed axes x, y, z, in this order."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # one of the angles may be chosen then, and is 0
        return np.asarray(Rotation.from_matrix(R).as_euler("xyz", degrees=True)) + 0.0


def _quarter_turns() -> list[FloatArray]:
    """The 24 rotations (3, 3) that map axes to axes, the identity first."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[np.arange(3), order] = signs
        if np.linalg.det(R) > 0.0:
            found.append(R)
    return found


def pairs_by_travel(scans: Sequence[SurveyScan], moved_m: float) -> list[tuple[int, int]]:
    """Pairs of scans with just so much travel in between, evenly over the drive."""
    positions = np.stack([scan.T_odom_body[:2, 3] for scan in scans])
    travel_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    return _evenly(_reached(travel_m, moved_m))


def spacing_of(scans: Sequence[SurveyScan]) -> float:
    """Median distance [m] of a detection from the nearest of its class in its scan, in space; at most its range."""
    some = scans[:: max(len(scans) // (4 * PAIRS), 1)]
    nearest = [nearest_of_class_m(scan.positions, scan.labels) for scan in some]
    return min(float(np.median(np.concatenate(nearest))), _median_range(scans))


def _median_range(scans: Sequence[SurveyScan]) -> float:
    return float(np.median(np.concatenate([np.linalg.norm(scan.positions, axis=1) for scan in scans])))


def _pairs_by_turn(headings_rad: FloatArray, least_rad: float) -> list[tuple[int, int]]:
    """Pairs of scans between which the body turns most for the time, evenly over the drive."""
    turn_rad = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(headings_rad)))])
    pairs = _reached(turn_rad, least_rad)
    rates = np.array([(turn_rad[second] - turn_rad[first]) / (second - first) for first, second in pairs])
    fastest = np.argsort(-rates, kind="stable")[: max(len(pairs) // 4, PAIRS)]
    return _evenly([pairs[index] for index in np.sort(fastest)])


def _reached(way: FloatArray, least: float) -> list[tuple[int, int]]:
    """Pairs (i, j) with j the first scan after i to which the way from i is ``least``."""
    second = np.searchsorted(way, way + least)
    return [(first, int(after)) for first, after in enumerate(second) if first < after < len(way)]


def _evenly(pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    chosen = np.linspace(0, max(len(pairs) - 1, 0), min(PAIRS, len(pairs))).astype(np.int64)
    return [pairs[index] for index in np.unique(chosen)]


def distance_of_nearest(
    scans: Sequence[SurveyScan], pairs: list[tuple[int, int]], R: FloatArray, limit_m: float
) -> float:
    """Median distance [m] of detections from the nearest of their class in the other scan of a pair, in the odometry
    frame, at most ``limit_m``; detections are turned by R (3, 3) first.
    """
    found = []
    for first, second in pairs:
        one, other = scans[first], scans[second]
        # Classes lie on layers that are farther apart than the limit.
        points, reference = (
            np.column_stack([apply(_upright(scan), scan.positions @ R.T), 10.0 * limit_m * scan.labels])
            for scan in (one, other)
        )
        distances, _ = cKDTree(reference).query(points, distance_upper_bound=limit_m)
        found.append(np.minimum(distances, limit_m))
    return float(np.median(np.concatenate(found)))


def _upright(scan: SurveyScan) -> FloatArray:
    return transform_from_xyz_yaw(scan.T_odom_body[:3, 3], yaw_rad(scan.T_odom_body))
