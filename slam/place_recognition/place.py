"""A candidate place of a query."""

from __future__ import annotations

from logs.records import frozen
from slam.common.arrays import FloatArray


@frozen
class Place:
    """A candidate pose of a query: ``T_local_query`` (4, 4), in the odometry frame of the traversal around ``travel_m``
    of a ``segment``.

    ``proposer``: one of :data:`logs.messages.PROPOSERS`;
    ``predicted_by``: the keyframe whose closure predicts the pose, None if none does.
    """

    T_local_query: FloatArray
    travel_m: float
    segment: int
    proposer: str
    predicted_by: int | None = None
