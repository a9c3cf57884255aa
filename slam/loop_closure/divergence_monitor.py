"""Detection of a lost localization: CUSUM test on whether the expected landmarks of the map are observed.

Each landmark of the map that comes into the field of view contributes one log-likelihood ratio of "not localized"
against "localized": negative if it is observed, positive if it is missed. The sum is clamped at zero (Page's cumulative
sum test, Biometrika 1954), so a long time of consistent observations does not outweigh recent missed ones.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert
from slam.object_map.submap import Submap

NEAR_RANGES, FAR_RANGES = 3.0 / 30.0, 20.0 / 30.0
"""Distances, in sensor ranges, at which a forward-looking sensor observes a landmark and rarely misses one."""
AHEAD_RAD = np.deg2rad(60.0)
MATCH_RADIUS_RANGES = 3.0 / 30.0
"""An object that near to a landmark of the map, in sensor ranges, is taken for it."""
KEYFRAMES_IN_VIEW = 3
"""A landmark is counted as observed or missed once it was expected at that many keyframes."""
DETECTION_PROBABILITY, FALSE_MATCH_PROBABILITY = 0.8, 0.1
"""Probability that an expected landmark is observed, and that another object is matched with it elsewhere."""
MISSED_LLR = float(np.log((1.0 - FALSE_MATCH_PROBABILITY) / (1.0 - DETECTION_PROBABILITY)))
SEEN_LLR = float(np.log(FALSE_MATCH_PROBABILITY / DETECTION_PROBABILITY))
LOST_LLR = 9.0
"""Threshold of the test: six missed landmarks in a row."""
GONE_KEYFRAMES = 6
"""A landmark expected at that many keyframes and never observed is gone."""
MIN_UNEXPECTED = 3
"""Least number of observed objects that the map does not have: without any the sensor may be blind."""


class LocalizationMonitor:
    """The CUSUM statistic over the landmarks that are expected in view."""

    def __init__(self, sensor_range_m: float) -> None:
        self._sensor_range_m = sensor_range_m
        self._expected_count: Counter[int] = Counter()
        self._ever_matched: set[int] = set()
        self.restart()

    def restart(self) -> None:
        """Reset the statistic and the landmarks in view."""
        self._llr = 0.0
        self._in_view: dict[int, int] = {}
        self._matched: set[int] = set()
        self._counted: set[int] = set()
        self._unexpected: set[int] = set()
        self._in_view_now: list[int] = []
        self.inconsistent_since: int | None = None
        """The first keyframe of the inconsistent observations that the statistic holds now."""

    @property
    def is_inconsistent(self) -> bool:
        """Whether the latest landmarks were missed more often than a localized robot misses them."""
        return self._llr > 0.0

    def update(self, keyframe: int, observed: Submap, reference: Submap, T_reference_query: FloatArray) -> bool:
        """Add the observations of a keyframe; returns whether the robot is lost.

        Args:
            keyframe: its id.
            observed: the landmarks in view, in the gravity frame of the keyframe.
            reference: the landmarks of the map around the estimated pose, in another frame.
            T_reference_query: (4, 4), estimated pose of the gravity frame in that frame.
        """
        in_view = np.flatnonzero(self._ahead(apply(invert(T_reference_query), reference.positions)))
        placed = apply(T_reference_query, observed.positions)
        apart_m = np.linalg.norm(reference.positions[:, None, :2] - placed[None, :, :2], axis=2)
        matches = (apart_m < MATCH_RADIUS_RANGES * self._sensor_range_m) & (
            reference.labels[:, None] == observed.labels
        )
        matched = reference.rows[matches.any(axis=1)].tolist()
        self._matched.update(matched)
        self._ever_matched.update(matched)
        self._unexpected.update(observed.rows[~matches.any(axis=0) & self._ahead(observed.positions)].tolist())
        self._in_view_now = reference.rows[in_view].tolist()
        for row in self._in_view_now:
            self._in_view[row] = self._in_view.get(row, 0) + 1
            if self._in_view[row] >= KEYFRAMES_IN_VIEW and row not in self._counted:
                self._counted.add(row)
                self._count(keyframe, row in self._matched)
        return self._llr >= LOST_LLR and len(self._unexpected) >= MIN_UNEXPECTED

    def confirm(self) -> None:
        """A closure confirmed the pose at the newest keyframe: count the landmarks that were expected there."""
        self._expected_count.update(self._in_view_now)

    def missing(self) -> IntArray:
        """Landmarks (K,) that were expected at ``GONE_KEYFRAMES`` keyframes and never observed."""
        gone = [
            row
            for row, count in self._expected_count.items()
            if count >= GONE_KEYFRAMES and row not in self._ever_matched
        ]
        return np.array(sorted(gone), dtype=np.int64)

    def _count(self, keyframe: int, is_observed: bool) -> None:
        if self._llr == 0.0:
            self._unexpected.clear()
            self.inconsistent_since = max(keyframe - KEYFRAMES_IN_VIEW, 0)
        self._llr = max(self._llr + (SEEN_LLR if is_observed else MISSED_LLR), 0.0)

    def _ahead(self, positions: FloatArray) -> NDArray[np.bool_]:
        """Which points (N,) of a body's gravity frame a sensor that looks ahead should see."""
        ranges = np.hypot(positions[:, 0], positions[:, 1])
        bearings = np.abs(np.arctan2(positions[:, 1], positions[:, 0]))
        near_m, far_m = NEAR_RANGES * self._sensor_range_m, FAR_RANGES * self._sensor_range_m
        return np.asarray((ranges > near_m) & (ranges < far_m) & (bearings < AHEAD_RAD))
