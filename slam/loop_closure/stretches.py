"""Sliding window of submaps for relocalization in an imported map."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from slam.loop_closure.candidate import Query
from slam.odometry.keyframe import Keyframe

STRETCHES = 6
"""Length of the window."""


class Stretches:
    """The queries at the ends of the latest stretches of ``step_m``."""

    def __init__(self, step_m: float) -> None:
        self._step_m = step_m
        self._queries: deque[Query] = deque(maxlen=STRETCHES)

    def before(self, keyframe: Keyframe) -> tuple[Query, ...]:
        """Those on the segment of a keyframe, the latest first."""
        segment = keyframe.odometry.segment
        return tuple(each for each in reversed(self._queries) if each.keyframe.odometry.segment == segment)

    def remember(self, query: Query) -> None:
        """Keep a query where a stretch ends."""
        if not self._queries or query.travel_m - self._queries[-1].travel_m >= self._step_m:
            self._queries.append(replace(query, before=()))
