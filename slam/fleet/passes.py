"""How the sessions of a part passed its landmarks: which they saw, and how much of a path each was in view of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray
from slam.fleet.part import Part

REACH_QUANTILE = 0.99
"""Share of the sightings that are nearer to the path than what is taken to be the reach of the sensors."""


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """Of L landmarks by M sessions: ``seen`` (L, M), and ``in_view_m`` (L, M), the length of the path of the session
    within the reach of the sensors from the landmark, 0 where it did not pass.
    """

    seen: BoolArray
    in_view_m: FloatArray


def find_passes(part: Part) -> Passes:
    """The passes of all sessions of a part, in their order."""
    landmarks = part.objects.positions[:, :2]
    seen = np.zeros((len(landmarks), len(part.visits)), dtype=np.bool_)
    steps = [_path(part.visits[number].steps[:, :, :2]) for number in part.sessions]
    for column, number in enumerate(part.sessions):
        seen[part.visits[number].landmarks, column] = True
    nearest_m = np.column_stack([_nearest_m(landmarks, each) for each in steps])
    # A little farther than the farthest sightings, so that these are in view themselves.
    reach_m = np.nextafter(np.quantile(nearest_m[seen], REACH_QUANTILE), np.inf) if seen.any() else 0.0
    return Passes(seen, np.column_stack([_in_view_m(landmarks, each, float(reach_m)) for each in steps]))


def _nearest_m(landmarks: FloatArray, steps: FloatArray) -> FloatArray:
    """Distance (L,) m of landmarks (L, 2) from a path of steps (S, 2, 2)."""
    along_m, aside_m, lengths_m = _abreast(landmarks, steps)
    return np.asarray(np.hypot(along_m - np.clip(along_m, 0.0, lengths_m), aside_m).min(axis=1))


def _in_view_m(landmarks: FloatArray, steps: FloatArray, reach_m: float) -> FloatArray:
    """Length (L,) m of a path of steps (S, 2, 2) that is nearer than ``reach_m`` to landmarks (L, 2)."""
    along_m, aside_m, lengths_m = _abreast(landmarks, steps)
    half_m = np.sqrt(np.maximum(reach_m**2 - aside_m**2, 0.0))
    in_view_m = np.minimum(along_m + half_m, lengths_m) - np.maximum(along_m - half_m, 0.0)
    return np.asarray(np.maximum(in_view_m, 0.0).sum(axis=1))


def _abreast(landmarks: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How far along each step (S, 2, 2) a landmark is abreast (L, S) m, and how far aside (L, S) m; lengths (S,) m."""
    lengths_m = np.linalg.norm(steps[:, 1] - steps[:, 0], axis=1)
    x, y = ((steps[:, 1] - steps[:, 0]) / np.maximum(lengths_m, 1e-12)[:, None]).T
    offset_x, offset_y = np.moveaxis(landmarks[:, None] - steps[:, 0], 2, 0)
    return offset_x * x + offset_y * y, offset_x * y - offset_y * x, lengths_m


def _path(steps: FloatArray) -> FloatArray:
    """The steps of a session by those between its places (S, 2, 2) m, and on to where it began and ended.

    A place is the middle of a stretch of the drive, and all stretches but the last are equally long: the drive began
    half a stretch before the first place, and ended beyond the last one by half of what that step lacks of a stretch.
    """
    lengths_m = np.linalg.norm(steps[:, 1] - steps[:, 0], axis=1)
    half_m = 0.5 * float(np.median(lengths_m))
    begin = _beyond(steps[0, 1], steps[0, 0], half_m)
    end = _beyond(steps[-1, 0], steps[-1, 1], max(float(lengths_m[-1]) - half_m, 0.0))
    return np.concatenate([[[begin, steps[0, 0]]], steps, [[steps[-1, 1], end]]])


def _beyond(start: FloatArray, end: FloatArray, length_m: float) -> FloatArray:
    """The point (2,) on the straight line from ``start`` through ``end``, ``length_m`` further."""
    step = end - start
    return end + step * (length_m / max(float(np.linalg.norm(step)), 1e-12))
