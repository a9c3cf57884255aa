"""How the members of a joint map passed its landmarks: which they saw, and how much of a path each was in view of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.backend.factors import EdgeKind
from slam.common.arrays import BoolArray, FloatArray
from slam.map_joining.joint_map import JointMap
from slam.object_map.map_io import are_of_kind

REACH_QUANTILE = 0.99
"""Share of the sightings that are nearer to the path than what is taken to be the reach of the sensors."""


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """Of L landmarks by M members: ``seen`` (L, M), and ``in_view_m`` (L, M), the length of the path of the member
    within the reach of the sensors from the landmark, 0 where it did not pass.
    """

    seen: BoolArray
    in_view_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Path:
    """Straight pieces ``starts`` (P, 2), ``ends`` (P, 2), m in the map."""

    starts: FloatArray
    ends: FloatArray


def find_passes(joint: JointMap) -> Passes:
    """The passes of all members of a joint map, in their order."""
    row_of = {name: row for row, name in enumerate(joint.objects.ids)}
    column_of = {number: column for column, number in enumerate(joint.members)}
    seen = np.zeros((len(row_of), len(column_of)), dtype=np.bool_)
    for sighting in joint.sightings:
        seen[row_of[sighting.landmark], column_of[sighting.map_number]] = True
    points = joint.objects.positions[:, :2]
    paths = [_path(joint, number) for number in joint.members]
    distances_m = np.column_stack([_distances_m(points, path) for path in paths])
    reach_m = float(np.quantile(distances_m[seen], REACH_QUANTILE)) if seen.any() else 0.0
    return Passes(seen, np.column_stack([_lengths_within_m(points, path, reach_m) for path in paths]))


def _path(joint: JointMap, number: int) -> _Path:
    """The path of a member through its places, and on to where it began and ended.

    A place is the middle of a stretch of the drive, and all stretches but the last are equally long: the drive began
    half a stretch before the first place, and ended beyond the last one by what that step lacks of a stretch, halved.
    """
    graph = joint.graph
    steps = graph.edge_keyframe_ids[are_of_kind(graph, EdgeKind.ODOMETRY)]
    steps = steps[joint.place_maps[steps[:, 0]] == number]
    positions = graph.T_map_body[:, :2, 3]
    if not len(steps):
        first = positions[np.flatnonzero(joint.place_maps == number)[:1]]
        return _Path(first, first)
    starts, ends = positions[steps[:, 0]], positions[steps[:, 1]]
    lengths_m = np.linalg.norm(ends - starts, axis=1)
    half_m = 0.5 * float(np.median(lengths_m))
    begin = _beyond(ends[0], starts[0], half_m)
    end = _beyond(starts[-1], ends[-1], max(float(lengths_m[-1]) - half_m, 0.0))
    return _Path(np.vstack([begin, starts, ends[-1]]), np.vstack([starts[0], ends, end]))


def _beyond(start: FloatArray, end: FloatArray, length_m: float) -> FloatArray:
    """The point (2,) on the straight line from ``start`` through ``end``, ``length_m`` further."""
    step = end - start
    return np.asarray(end + step * (length_m / max(float(np.linalg.norm(step)), 1e-12)))


def _distances_m(points: FloatArray, path: _Path) -> FloatArray:
    """Distance (N,) of points (N, 2) from a path."""
    nearest = np.full(len(points), np.inf)
    for start, step in zip(path.starts, path.ends - path.starts, strict=True):
        share = np.clip((points - start) @ step / max(float(step @ step), 1e-12), 0.0, 1.0)
        offsets = points - start - share[:, None] * step
        nearest = np.minimum(nearest, np.hypot(offsets[:, 0], offsets[:, 1]))
    return nearest


def _lengths_within_m(points: FloatArray, path: _Path, reach_m: float) -> FloatArray:
    """Length (N,) of a path within a circle of ``reach_m`` around each of some points (N, 2)."""
    total = np.zeros(len(points))
    for start, step in zip(path.starts, path.ends - path.starts, strict=True):
        length_m = float(np.linalg.norm(step))
        if length_m == 0.0:
            continue
        offsets = points - start
        middle = offsets @ step / length_m
        half2 = reach_m**2 - (np.einsum("ni,ni->n", offsets, offsets) - middle**2)
        half = np.sqrt(np.maximum(half2, 0.0))
        total += np.clip(middle + half, 0.0, length_m) - np.clip(middle - half, 0.0, length_m)
    return total
