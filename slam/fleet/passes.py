"""How the sessions of a part passed its landmarks: which they saw, and how far from each their paths were."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray
from slam.fleet.part import Part


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """Of L landmarks by M sessions: ``seen`` (L, M), and ``distances_m`` (L, M) of the landmarks from the paths."""

    seen: BoolArray
    distances_m: FloatArray


def find_passes(part: Part) -> Passes:
    """The passes of all sessions of a part, in their order."""
    landmarks = part.objects.positions[:, :2]
    visits = [part.visits[number] for number in part.sessions]
    seen = np.zeros((len(landmarks), len(visits)), dtype=np.bool_)
    for column, visit in enumerate(visits):
        seen[visit.landmarks, column] = True
    return Passes(seen, np.column_stack([_distances_m(landmarks, visit.steps[:, :, :2]) for visit in visits]))


def _distances_m(points: FloatArray, steps: FloatArray) -> FloatArray:
    """Distances (N,) m of points (N, 2) from a path of steps (S, 2, 2)."""
    ways = steps[:, 1] - steps[:, 0]
    offsets = points[:, None] - steps[:, 0]
    along = np.einsum("nsi,si->ns", offsets, ways) / np.maximum(np.einsum("si,si->s", ways, ways), 1e-12)
    return np.asarray(np.linalg.norm(offsets - along.clip(0.0, 1.0)[..., None] * ways, axis=2).min(axis=1))
