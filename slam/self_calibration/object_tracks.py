"""Objects followed from scan to scan by the odometry alone, as far as that is unambiguous.

A detection continues the track of its class that ended nearest to it, in the odometry frame, if each is the other's
nearest and they are much nearer to one another than other objects of the class are. Nothing here knows a length or a
noise: the spacing of the objects is the yardstick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray, IntArray

AMBIGUITY = 0.5
"""A track goes on with a detection nearer than this share of the distance to the next object of its class."""
RANGE_SHARE = 0.25
"""... and of the range, for an object that is alone of its class."""
MISSED_SCANS = 2
"""Scans in a row in which an object may be missed before its track ends."""


@dataclass(frozen=True, slots=True, eq=False)
class SurveyScan:
    """One scan: ``stamp_ns``; where the body was, ``T_odom_body`` (4, 4); detections in the upright frame of the body:
    ``positions`` (N, 3) m, ``labels`` (N,), ``variances`` (N,) m^2 that the message claims, NaN where it has none.
    """

    stamp_ns: int
    T_odom_body: FloatArray
    positions: FloatArray
    labels: IntArray
    variances: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ObjectTracks:
    """Detections (S,) that belong to tracks, ordered by track and time.

    ``track`` and ``scan`` (S,): ids; ``offsets`` (S, 2) m from the body and ``points`` (S, 2) m, both in the axes of
    the odometry frame; ``labels`` (S,); ``claimed`` (S,) m^2; ``heights`` (S,) m in the odometry frame.
    """

    track: IntArray
    scan: IntArray
    offsets: FloatArray
    points: FloatArray
    labels: IntArray
    claimed: FloatArray
    heights: FloatArray


def follow_objects(scans: Sequence[SurveyScan], headings_rad: FloatArray) -> ObjectTracks:
    """Tracks of the objects in ``scans`` (K), whose bodies head to ``headings_rad`` (K,) in the odometry frame."""
    tracks, numbers = [], []
    offsets, points, labels, claimed, heights = [], [], [], [], []
    ends = _OpenTracks()
    for number, (scan, heading) in enumerate(zip(scans, headings_rad, strict=True)):
        c, s = np.cos(heading), np.sin(heading)
        offset = scan.positions[:, :2] @ np.array([[c, s], [-s, c]])
        point = offset + scan.T_odom_body[:2, 3]
        tracks.append(ends.extend(number, point, np.hypot(offset[:, 0], offset[:, 1]), scan.labels))
        numbers.append(np.full(len(point), number))
        offsets.append(offset)
        points.append(point)
        labels.append(scan.labels)
        claimed.append(scan.variances)
        heights.append(scan.positions[:, 2] + scan.T_odom_body[2, 3])
    if not tracks:
        none, nowhere = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
        return ObjectTracks(none, none, nowhere, nowhere, none, np.zeros(0), np.zeros(0))
    track, scan_of = np.concatenate(tracks), np.concatenate(numbers)
    order = np.lexsort((scan_of, track))
    return ObjectTracks(
        track[order],
        scan_of[order],
        np.concatenate(offsets)[order],
        np.concatenate(points)[order],
        np.concatenate(labels)[order],
        np.concatenate(claimed)[order],
        np.concatenate(heights)[order],
    )


class _OpenTracks:
    """The last detection of each track that may go on."""

    def __init__(self) -> None:
        self._count = 0
        self._points = np.zeros((0, 2))
        self._labels = np.zeros(0, dtype=np.int64)
        self._tracks = np.zeros(0, dtype=np.int64)
        self._scans = np.zeros(0, dtype=np.int64)

    def extend(self, scan: int, points: FloatArray, ranges: FloatArray, labels: IntArray) -> IntArray:
        """Tracks (N,) of the detections of a scan; those that continue none begin one."""
        tracks = np.full(len(points), -1, dtype=np.int64)
        if len(points) and len(self._points):
            tracks = self._continued(points, ranges, labels)
        fresh = tracks < 0
        tracks[fresh] = self._count + np.arange(int(fresh.sum()))
        self._count += int(fresh.sum())
        kept = (scan - self._scans <= MISSED_SCANS) & ~np.isin(self._tracks, tracks)
        self._points = np.concatenate([self._points[kept], points])
        self._labels = np.concatenate([self._labels[kept], labels])
        self._tracks = np.concatenate([self._tracks[kept], tracks])
        self._scans = np.concatenate([self._scans[kept], np.full(len(points), scan)])
        return tracks

    def _continued(self, points: FloatArray, ranges: FloatArray, labels: IntArray) -> IntArray:
        apart = np.linalg.norm(points[:, None] - self._points[None], axis=2)
        apart[labels[:, None] != self._labels[None]] = np.inf
        nearest = np.argmin(apart, axis=1)
        rows = np.arange(len(points))
        distances = apart[rows, nearest]
        mutual = np.argmin(apart, axis=0)[nearest] == rows
        apart[rows, nearest] = np.inf
        others = np.linalg.norm(points[:, None] - points[None], axis=2)
        others[(labels[:, None] != labels[None]) | np.eye(len(points), dtype=np.bool_)] = np.inf
        room = AMBIGUITY * np.minimum(apart.min(axis=1), others.min(axis=1))
        continues = mutual & (distances < np.minimum(room, RANGE_SHARE * ranges))
        return np.where(continues, self._tracks[nearest], -1)
