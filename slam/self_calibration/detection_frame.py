"""Which frame detections are in, if it is not the one that their messages name: that of the body or of the odometry.

In the right frame the detections of two scans, put into the odometry frame, lie on each other. The objects of a tracker
stand still already: taken for those of a sensor on the body, they seem to move along with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slam.self_calibration.object_tracks import SurveyScan
from slam.self_calibration.sensor_orientation import (
    BETTER,
    LEAST_PAIRS,
    MOVED_SPACINGS,
    distance_of_nearest,
    pairs_by_travel,
    spacing_of,
)


def agree(scans: Sequence[SurveyScan]) -> bool:
    """Whether scans (K) lie on one another nearer than the body moved in between; so do scans that cannot tell."""
    if not scans:
        return True
    spacing_m = spacing_of(scans)
    apart_m = _apart(scans, spacing_m)
    return not np.isfinite(apart_m) or apart_m < BETTER * MOVED_SPACINGS * spacing_m


def better_frame(as_they_are: Sequence[SurveyScan], others: Mapping[str, Sequence[SurveyScan]]) -> str | None:
    """The name of that among other frames in which the scans agree far better; None where there is none."""
    found = {name: scans for name, scans in others.items() if scans}
    if not found or not as_they_are:
        return None
    spacing_m = min(spacing_of(scans) for scans in (as_they_are, *found.values()))
    apart_m = {name: _apart(scans, spacing_m) for name, scans in found.items()}
    best = min(apart_m, key=lambda name: apart_m[name])
    return best if apart_m[best] < BETTER * _apart(as_they_are, spacing_m) else None


def _apart(scans: Sequence[SurveyScan], spacing_m: float) -> float:
    """How far [m] detections lie from those of another scan, taken some travel later; NaN where too few tell."""
    moved_m = MOVED_SPACINGS * spacing_m
    pairs = [
        (first, second)
        for first, second in pairs_by_travel(scans, moved_m)
        if 2.0 * np.linalg.norm((scans[second].T_odom_body - scans[first].T_odom_body)[:2, 3]) > moved_m
    ]
    if len(pairs) < LEAST_PAIRS:
        return float("nan")
    return distance_of_nearest(scans, pairs, np.eye(3), spacing_m)
