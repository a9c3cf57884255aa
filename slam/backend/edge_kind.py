"""Kinds of edges between keyframes; reading a map needs them, but not the solver."""

from enum import StrEnum


class EdgeKind(StrEnum):
    """Origin of an edge; the values are those in logs.

    ``DISCONTINUITY``: the odometry jumped, paused or restarted, so the edge holds no information, but keeps the graph
    connected until a closure does it. ``GNSS``: a fix of satellites, which holds a position in the plane; in logs from
    the first keyframe. ``CONDENSED``: a keyframe at one end represents one of a later traversal.
    """

    ODOMETRY = "odometry"
    DISCONTINUITY = "discontinuity"
    LOOP_CLOSURE = "closure"
    GNSS = "gnss"
    CONDENSED = "condensed"
