"""Whether what is seen goes on agreeing with the place where the robot is believed to be.

Every landmark of the map that comes near ahead is a question, asked once: is it seen? A robot that is where it is
believed to be sees most of them, one that was carried off hardly any. The log likelihood ratio of the two is summed up
and never falls below zero (Page's cumulative sum test, Biometrika 1954), so that a long time of agreement does not
outweigh what happens now.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert
from slam.object_map.submap import Submap

NEAR_M, FAR_M = 3.0, 20.0
"""What stands that far ahead is seen by any sensor that looks ahead, and so near that it is rarely missed."""
AHEAD_RAD = np.deg2rad(60.0)
MEETS_M = 3.0
KEYFRAMES_IN_VIEW = 3
"""A landmark has been looked for once it was due at that many keyframes."""
SEEN_HERE, SEEN_ELSEWHERE = 0.8, 0.1
"""How likely a landmark is seen, as some are gone or hidden, and how likely another is taken for it."""
MISSED_NATS = float(np.log((1.0 - SEEN_ELSEWHERE) / (1.0 - SEEN_HERE)))
SEEN_NATS = float(np.log(SEEN_ELSEWHERE / SEEN_HERE))
LOST_NATS = 9.0
"""Six landmarks in a row that are not there."""
GONE_KEYFRAMES = 6
"""A landmark that was due so often, and never met, is gone; that is some 12 m of travel towards it."""
LEAST_OTHERS = 3
"""Objects that the map does not have there: one who sees nothing at all is blind, not elsewhere."""


class PlaceWatch:
    """Asks for the landmarks that come near."""

    def __init__(self) -> None:
        self._looked_for: Counter[int] = Counter()
        self._ever_met: set[int] = set()
        self.restart()

    def restart(self) -> None:
        """Begin to ask anew."""
        self._nats = 0.0
        self._due: dict[int, int] = {}
        self._met: set[int] = set()
        self._asked: set[int] = set()
        self._others: set[int] = set()
        self._due_now: list[int] = []
        self.doubted_since = -1
        """The first keyframe of those that make the place doubtful now."""

    @property
    def doubts(self) -> bool:
        """Whether the last landmarks asked for speak against the place."""
        return self._nats > 0.0

    def look(self, keyframe: int, seen: Submap, around: Submap, T_around_query: FloatArray) -> bool:
        """Take in a keyframe; returns whether the robot is elsewhere.

        Args:
            keyframe: its id.
            seen: what is in view, in its gravity frame.
            around: the landmarks around the place, in another frame.
            T_around_query: (4, 4) where the gravity frame is believed to be in that one.
        """
        due = np.flatnonzero(_ahead(apply(invert(T_around_query), around.positions)))
        placed = apply(T_around_query, seen.positions)
        apart_m = np.linalg.norm(around.positions[:, None, :2] - placed[None, :, :2], axis=2)
        meets = (apart_m < MEETS_M) & (around.labels[:, None] == seen.labels)
        met = around.rows[meets.any(axis=1)].tolist()
        self._met.update(met)
        self._ever_met.update(met)
        self._others.update(seen.rows[~meets.any(axis=0) & _ahead(seen.positions)].tolist())
        self._due_now = around.rows[due].tolist()
        for row in self._due_now:
            self._due[row] = self._due.get(row, 0) + 1
            if self._due[row] >= KEYFRAMES_IN_VIEW and row not in self._asked:
                self._asked.add(row)
                self._count(keyframe, row in self._met)
        return self._nats >= LOST_NATS and len(self._others) >= LEAST_OTHERS

    def confirm(self) -> None:
        """The newest keyframe was recognised, so what was due there was looked for in the right place."""
        self._looked_for.update(self._due_now)

    def missing(self) -> IntArray:
        """Landmarks (K,) that were looked for at many keyframes and met at none."""
        gone = [row for row, count in self._looked_for.items() if count >= GONE_KEYFRAMES and row not in self._ever_met]
        return np.array(sorted(gone), dtype=np.int64)

    def _count(self, keyframe: int, is_seen: bool) -> None:
        if self._nats == 0.0:
            self._others.clear()
            self.doubted_since = max(keyframe - KEYFRAMES_IN_VIEW, 0)
        self._nats = max(self._nats + (SEEN_NATS if is_seen else MISSED_NATS), 0.0)


def _ahead(positions: FloatArray) -> NDArray[np.bool_]:
    """Which points (N,) of a body's gravity frame any sensor that looks ahead should see."""
    ranges = np.hypot(positions[:, 0], positions[:, 1])
    bearings = np.abs(np.arctan2(positions[:, 1], positions[:, 0]))
    return np.asarray((ranges > NEAR_M) & (ranges < FAR_M) & (bearings < AHEAD_RAD))
