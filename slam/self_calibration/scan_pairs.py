"""Pairs of scans between which the body moved, and how near its motion brings their detections to one another."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply_each, gravity_frame, invert, travelled_m
from slam.self_calibration.corrections import BLOCKS, is_beyond_chance
from slam.self_calibration.object_tracks import SurveyScan, headings_of, layered, nearest_of_class_m, poses_of

MOVED_SPACINGS = 0.25
"""Between the scans of a pair, the body moves past its objects, by travel or turn, by that share of their spacing."""
RESOLVED_SPACINGS = 0.05
"""Distances are told apart down to about that share of the spacing."""
MIN_PAIRS, FEW, MAX_DETECTIONS = 40, 300, 10_000
"""A quarter of the turns is the fastest, all if there are few; so many detections of turns are compared at most, and as
many pairs by travel as by turn.
"""
SAMPLED_SCANS = 600


class ScanPairs:
    """Pairs (P, 2) of ``scans`` (K): ``rows``; ``spacing_m``: of the objects; ``motions`` (P, 4, 4): of the body from
    the first scan to the second.
    """

    def __init__(self, scans: Sequence[SurveyScan], rows: IntArray, spacing_m: float) -> None:
        self.rows = rows
        self.spacing_m = spacing_m
        T_odom_body = poses_of(scans)
        self.motions = self.motions_by(T_odom_body)
        self._T_upright_body = (invert(gravity_frame(T_odom_body)) @ T_odom_body)[rows.T]
        # Only detections of one pair and class are near one another.
        reference, self._detections = (layered([scans[row] for row in side], 10.0 * spacing_m) for side in rows.T)
        self._pair = np.repeat(np.arange(len(rows)), [len(scans[row].labels) for row in rows[:, 1]])
        self._tree = cKDTree(reference)

    @classmethod
    def by_travel(cls, scans: Sequence[SurveyScan], spacing_m: float, factor: float) -> "ScanPairs":
        """Pairs between which the body travels, where the lengths of the odometry are multiplied by a factor."""
        poses = poses_of(scans)
        poses[:, :3, 3] *= factor
        moved = [replace(scan, T_odom_body=T) for scan, T in zip(scans, poses, strict=True)]
        return cls(moved, _evenly(_travels(moved, spacing_m), FEW), spacing_m)

    @classmethod
    def of(cls, scans: Sequence[SurveyScan], spacing_m: float, *, fastest: bool = True) -> "ScanPairs":
        """Pairs between which the body travels, and pairs between which it turns, ``fastest``: most for the time."""
        turned_rad = travelled_m(headings_of(scans)[:, None])
        turns = _reached(turned_rad, MOVED_SPACINGS * spacing_m / max(median_range(scans), 1e-9))
        if fastest:
            first, second = turns.T
            rates = (turned_rad[second] - turned_rad[first]) / (second - first)
            turns = turns[np.sort(np.argsort(-rates, kind="stable")[: max(len(turns) // 4, FEW)])]
        turns = _evenly(turns, round(MAX_DETECTIONS * len(scans) / sum(len(scan.labels) for scan in scans)))
        travels = _evenly(_travels(scans, spacing_m), max(len(turns), FEW))
        return cls(scans, np.concatenate([travels, turns]), spacing_m)

    def motions_by(self, T_odom_body: FloatArray) -> FloatArray:
        """Motions (P, 4, 4) of the body by poses (K, 4, 4), without roll and pitch."""
        poses = gravity_frame(T_odom_body)
        return invert(poses[self.rows[:, 0]]) @ poses[self.rows[:, 1]]

    def seen_by(self, T_body_sensor: FloatArray, motions: FloatArray) -> FloatArray:
        """Motions (P, 4, 4) of a sensor at a pose (4, 4) on the body, which may lean, by those of the upright body."""
        first, second = (T @ T_body_sensor @ invert(T) for T in self._T_upright_body)
        return invert(first) @ motions @ second

    def log_distances(self, motions: FloatArray) -> FloatArray:
        """Mean log distances (P, 2) of the detections of the second scan from the nearest of their class in the first
        one, at most the spacing, by the motions (P, 4, 4) and by their inverse.
        """
        found = np.zeros(self.rows.shape)
        counts = np.maximum(np.bincount(self._pair, minlength=len(found)), 1)
        for column, T in enumerate((motions, invert(motions))):
            moved = self._detections.copy()
            moved[:, :3] = apply_each(T[self._pair], moved[:, :3])
            distances, _ = self._tree.query(moved, distance_upper_bound=self.spacing_m)
            squares = np.minimum(distances, self.spacing_m) ** 2 + (RESOLVED_SPACINGS * self.spacing_m) ** 2
            found[:, column] = 0.5 * np.bincount(self._pair, np.log(squares), minlength=len(found)) / counts
        return found


def evidence(distances: FloatArray) -> FloatArray:
    """How much nearer the motion brings the scans of pairs than its inverse, (P,), by their log distances (P, 2)."""
    return distances[:, 1] - distances[:, 0]


def is_better(distances: FloatArray, now: FloatArray, factor: float) -> bool:
    """Whether there is more evidence, by the ``factor``, and scans are nearer together, by log distances (P, 2)."""
    more = evidence(distances) - factor * evidence(now)
    return is_positive(more) and is_positive(now[:, 0] - distances[:, 0])


def is_positive(values: FloatArray) -> bool:
    """Whether the sum of values (P,) is larger than 0 by more than rounding, and than chance by the sums of blocks:
    neighbours see the same objects, and overlap.
    """
    if len(values) < MIN_PAIRS:
        return False
    sums = np.array([np.sum(block) for block in np.array_split(values, BLOCKS)])
    return float(np.mean(values)) > 1e-9 and is_beyond_chance(sums)


def spacing_of(scans: Sequence[SurveyScan]) -> float:
    """Median distance [m] of a detection from the nearest of its class in its scan, in space; at most its range."""
    some = scans[:: max(len(scans) // SAMPLED_SCANS, 1)]
    return min(np.median(nearest_of_class_m(some)), median_range(scans))


def median_range(scans: Sequence[SurveyScan]) -> float:
    """Median distance [m] of detections from the body."""
    return float(np.median(np.linalg.norm(np.concatenate([scan.positions for scan in scans]), axis=1)))


def _travels(scans: Sequence[SurveyScan], spacing_m: float) -> IntArray:
    """Pairs between which the body goes past its objects."""
    positions, moved_m = poses_of(scans)[:, :2, 3], MOVED_SPACINGS * spacing_m
    pairs = _reached(travelled_m(positions), moved_m)
    first, second = positions[pairs].swapaxes(0, 1)
    # An odometry that trembles while the body stands goes nowhere.
    return pairs[2.0 * np.linalg.norm(second - first, axis=1) > moved_m]


def _reached(way: FloatArray, least: float) -> IntArray:
    """Pairs (P, 2) of i and j, the first scan after i to which the way from i is ``least``."""
    first, second = np.arange(len(way)), np.searchsorted(way, way + least)
    # With less of a way the pairs would have most of it in common.
    chosen = np.flatnonzero((first < second) & (second < len(way)) & (way[-1] >= BLOCKS * least))
    return np.column_stack([chosen, second[chosen]])


def _evenly(pairs: IntArray, count: int) -> IntArray:
    chosen = np.linspace(0, len(pairs) - 1, min(count, len(pairs))).astype(np.int64)
    return pairs[np.unique(chosen)]
