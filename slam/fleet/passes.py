"""How the sessions of a part passed its landmarks: which they saw, and how much of a path each was in view of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from slam.common.arrays import BoolArray, FloatArray
from slam.fleet.part import Part

REACH_QUANTILE = 0.99
"""Share of the sightings that are nearer to the path than what is taken to be the reach of the sensors."""
SAMPLES_A_STEP = 25
"""Points of a path between two places, so that a length in view is known to a few percent of a stretch."""


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
    paths = []
    for column, number in enumerate(part.sessions):
        seen[part.visits[number].landmarks, column] = True
        paths.append(_path(part.visits[number].steps[:, :, :2]))
    nearest_m = np.column_stack([cdist(landmarks, points).min(axis=1) for points, _ in paths])
    reach_m = float(np.quantile(nearest_m[seen], REACH_QUANTILE)) if seen.any() else 0.0
    in_view_m = [(cdist(landmarks, points) <= reach_m) @ lengths_m for points, lengths_m in paths]
    return Passes(seen, np.column_stack(in_view_m))


def _path(steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The path of a session through its places by steps (S, 2, 2) m, and on to where it began and ended.

    A place is the middle of a stretch of the drive, and all stretches but the last are equally long: the drive began
    half a stretch before the first place, and ended beyond the last one by half of what that step lacks of a stretch.

    Returns:
        Points (P, 2) m of the path, and the length (P,) m of the piece that each stands for.
    """
    lengths_m = np.linalg.norm(steps[:, 1] - steps[:, 0], axis=1)
    half_m = 0.5 * float(np.median(lengths_m))
    begin = _beyond(steps[0, 1], steps[0, 0], half_m)
    end = _beyond(steps[-1, 0], steps[-1, 1], max(float(lengths_m[-1]) - half_m, 0.0))
    steps = np.concatenate([[[begin, steps[0, 0]]], steps, [[steps[-1, 1], end]]])
    shares = (np.arange(SAMPLES_A_STEP) + 0.5) / SAMPLES_A_STEP
    directions = steps[:, 1] - steps[:, 0]
    points = steps[:, :1] + shares[:, None] * directions[:, None]  # (steps, SAMPLES_A_STEP, 2)
    pieces_m = np.linalg.norm(directions, axis=1) / SAMPLES_A_STEP
    return points.reshape(-1, 2), np.repeat(pieces_m, SAMPLES_A_STEP)


def _beyond(start: FloatArray, end: FloatArray, length_m: float) -> FloatArray:
    """The point (2,) on the straight line from ``start`` through ``end``, ``length_m`` further."""
    step = end - start
    return np.asarray(end + step * (length_m / max(float(np.linalg.norm(step)), 1e-12)))
