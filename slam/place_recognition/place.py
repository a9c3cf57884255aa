"""A candidate place of a query."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.object_map.landmarks import ObjectMap


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A candidate pose of a query: ``T_local_query`` (4, 4), in the odometry frame of the traversal around ``travel_m``
    of a ``segment``.

    ``proposer``: one of :data:`logs.messages.PROPOSERS`;
    ``rank``: from 1, among the places retrieved for a query, 0 for a place that was not retrieved;
    ``predicted_by``: the keyframe whose closure predicts the pose, None if none does.
    """

    T_local_query: FloatArray
    travel_m: float
    segment: int
    proposer: str
    rank: int = 0
    predicted_by: int | None = None


def traversal_of(object_map: ObjectMap, rows: IntArray, *, extent_m: float) -> tuple[int, float]:
    """Segment and travel [m] of the traversal that most of the landmarks ``rows`` (K,), one at least, are from.

    A place that was passed several times has landmarks from each of the passes; a traversal reaches ``extent_m`` before
    and after its middle.
    """
    of_segment = object_map.rows["segment"][rows]
    segments, counts = np.unique(of_segment, return_counts=True)
    segment = int(segments[np.argmax(counts)])
    travels_m = np.sort(object_map.rows["first_seen_travel_m"][rows[of_segment == segment]])
    ends = np.searchsorted(travels_m, travels_m + 2.0 * extent_m, side="right")
    start = int(np.argmax(ends - np.arange(len(ends))))
    return segment, float(np.median(travels_m[start : ends[start]]))
