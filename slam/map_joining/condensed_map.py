"""A map of a drive condensed to few upright places: the observations of a stretch, as seen from its middle.

Keyframes stand metres apart and see the same landmarks again and again. Once a drive is optimised, a place every
sensor range keeps its shape: the observations of a landmark in a stretch become one, by the sum of their information,
and the steps of the odometry between two places one edge.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from logs.messages import FactorGraphRecord
from slam.backend.factors import Edge, EdgeKind, Observation
from slam.backend.graph_record import make_graph_record
from slam.backend.observation_sums import sum_observations
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import adjoint, apply, covariance_in_axes, invert
from slam.object_map.map_io import SavedMap, are_of_kind
from slam.object_map.submap import SUBMAP_RANGES, gravity_frame

MIN_DISTANCE_SHARE = 0.02
"""A landmark nearer to a place, in lengths of a stretch, has no bearing there; the places beside it observe it."""


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """``of`` (K,): stretch of each keyframe, ascending; ``middles`` (S,): row of the keyframe in the middle of each;
    ``steps``: edge from a row to the next one of its drive.
    """

    of: IntArray
    middles: IntArray
    steps: Mapping[int, int]


def stretch_length_m(config: Config) -> float:
    """Travel [m] between two places: half of that of a submap."""
    return 0.5 * SUBMAP_RANGES * config.sensor_range_m


def condense_map(saved: SavedMap, *, stretch_m: float) -> SavedMap:
    """The same landmarks, observed from a place in each stretch of ``stretch_m`` of travel.

    The keyframes of the result are these places, upright, numbered from 0 along the drive; edges of kind odometry lead
    from each to the next one, those of kind closure are loop closures between stretches.
    """
    return _condense(saved, _stretches(saved.graph, stretch_m), stretch_m)


def condense_area(saved: SavedMap, *, stretch_m: float) -> SavedMap:
    """The same landmarks, observed from one place in each cell of ``stretch_m`` that a drive passed.

    However many drives there are, the graph is as large as their area; its edges are all of kind closure.
    """
    return _condense(saved, _cells(saved.graph, stretch_m), stretch_m)


def _condense(saved: SavedMap, stretches: _Stretches, stretch_m: float) -> SavedMap:
    graph = saved.graph
    T_map_place = gravity_frame(graph.T_map_body[stretches.middles])
    condensed = make_graph_record(
        graph.stamp_ns,
        np.arange(len(T_map_place)),
        graph.keyframe_stamps_ns[stretches.middles],
        T_map_place,
        [*_edges(graph, stretches, T_map_place), *_observations(saved, stretches, T_map_place, stretch_m)],
        saved.objects.ids.__getitem__,
        np.zeros((0, 6, 6)),
    )
    return replace(saved, graph=condensed)


def _stretches(graph: FactorGraphRecord, stretch_m: float) -> _Stretches:
    count = len(graph.keyframe_ids)
    row_of = {keyframe: row for row, keyframe in enumerate(graph.keyframe_ids.tolist())}
    steps: dict[int, int] = {}
    for edge in np.flatnonzero(are_of_kind(graph, EdgeKind.ODOMETRY)).tolist():
        first, second = (row_of[keyframe] for keyframe in graph.edge_keyframe_ids[edge].tolist())
        if second == first + 1:
            steps[first] = edge
    of, travel_m = np.zeros(count, dtype=np.int64), np.zeros(count)
    for row in range(1, count):
        if row - 1 not in steps:
            of[row] = of[row - 1] + 1
            continue
        travel_m[row] = travel_m[row - 1] + np.linalg.norm(graph.edge_transforms[steps[row - 1], :3, 3])
        is_next = travel_m[row] // stretch_m > travel_m[row - 1] // stretch_m
        of[row] = of[row - 1] + is_next
    firsts = np.flatnonzero(np.diff(of, prepend=-1))
    lasts = np.append(firsts[1:], count) - 1
    wanted_m = 0.5 * (travel_m[firsts] + travel_m[lasts])
    middles = [
        first + int(np.abs(travel_m[first : last + 1] - at_m).argmin())
        for first, last, at_m in zip(firsts.tolist(), lasts.tolist(), wanted_m.tolist(), strict=True)
    ]
    return _Stretches(of, np.array(middles, dtype=np.int64), steps)


def _cells(graph: FactorGraphRecord, side_m: float) -> _Stretches:
    """The keyframes in a cell, of whichever drive, in place of those in a stretch; no steps relate their middles."""
    positions = graph.T_map_body[:, :3, 3]
    of = np.unique(np.floor(positions / side_m), axis=0, return_inverse=True)[1].ravel()
    middles = []
    for cell in range(int(of.max()) + 1):
        rows = np.flatnonzero(of == cell)
        offsets = positions[rows] - positions[rows].mean(axis=0)
        middles.append(int(rows[np.linalg.norm(offsets, axis=1).argmin()]))
    return _Stretches(of, np.array(middles, dtype=np.int64), {})


def _edges(graph: FactorGraphRecord, stretches: _Stretches, T_map_place: FloatArray) -> list[Edge]:
    """Edges between places, numbered from 0: those of the odometry, and one for each two that other edges relate."""
    found: dict[tuple[int, int], tuple[FloatArray, EdgeKind]] = {}
    for place, (first, last) in enumerate(zip(stretches.middles[:-1], stretches.middles[1:], strict=True)):
        steps = [stretches.steps.get(row, -1) for row in range(first, last)]
        if min(steps, default=-1) >= 0:
            found[place, place + 1] = _composed(graph, steps, last), EdgeKind.ODOMETRY
    place_of = dict(zip(graph.keyframe_ids.tolist(), stretches.of.tolist(), strict=True))
    is_between = are_of_kind(graph, EdgeKind.ODOMETRY) | are_of_kind(graph, EdgeKind.LOOP_CLOSURE)
    for edge in np.flatnonzero(is_between).tolist():
        first, second = (place_of[keyframe] for keyframe in graph.edge_keyframe_ids[edge].tolist())
        if first != second:
            found.setdefault((first, second), (graph.edge_covariances[edge], EdgeKind.LOOP_CLOSURE))
    return [
        Edge(first, second, invert(T_map_place[first]) @ T_map_place[second], covariance, kind)
        for (first, second), (covariance, kind) in found.items()
    ]


def _composed(graph: FactorGraphRecord, steps: list[int], last: int) -> FloatArray:
    """Covariance (6, 6) of a chain of edges, in the upright frame of its last keyframe, row ``last``."""
    P = np.zeros((6, 6))
    for step in steps:
        A = adjoint(invert(graph.edge_transforms[step]))
        P = A @ P @ A.T + graph.edge_covariances[step]
    T_map_body = graph.T_map_body[last]
    return covariance_in_axes(P, T_map_body[:3, :3].T @ gravity_frame(T_map_body)[:3, :3])


def _observations(
    saved: SavedMap, stretches: _Stretches, T_map_place: FloatArray, stretch_m: float
) -> list[Observation]:
    """One observation of each landmark from each place of which a keyframe saw it; landmarks by their rows."""
    graph, objects = saved.graph, saved.objects
    row_of = {keyframe: row for row, keyframe in enumerate(graph.keyframe_ids.tolist())}
    landmark_of = {name: row for row, name in enumerate(objects.ids)}
    rows = np.array([row_of[keyframe] for keyframe in graph.observation_keyframe_ids.tolist()], dtype=np.int64)
    landmarks = np.array([landmark_of[name] for name in graph.observation_landmark_ids], dtype=np.int64)
    places = stretches.of[rows]
    T_place_map = invert(T_map_place[places])
    R_place_body = T_place_map[:, :3, :3] @ graph.T_map_body[rows, :3, :3]
    positions = np.einsum("nij,nj->ni", T_place_map[:, :3, :3], objects.positions[landmarks]) + T_place_map[:, :3, 3]
    is_far = np.linalg.norm(positions, axis=1) > MIN_DISTANCE_SHARE * stretch_m
    summed = sum_observations(
        places[is_far],
        landmarks[is_far],
        positions[is_far],
        (R_place_body @ graph.observation_covariances @ np.swapaxes(R_place_body, 1, 2))[is_far],
        np.ones(np.count_nonzero(is_far)),
    )
    # Between two drives the kernel is as wide as that of one observation.
    return [
        replace(each, covariance=each.covariance_inflation * each.covariance, covariance_inflation=1.0)
        for each in summed
    ]


def place_submap_rows(condensed: SavedMap, place: int) -> IntArray:
    """Rows (N,) of the landmarks that were observed from a place and those before and after it on its drive."""
    graph = condensed.graph
    is_driven = are_of_kind(graph, EdgeKind.ODOMETRY)
    beside = graph.edge_keyframe_ids[is_driven & (graph.edge_keyframe_ids == place).any(axis=1)]
    around = np.unique(np.append(beside, place))
    row_of = {name: row for row, name in enumerate(condensed.objects.ids)}
    names = np.array(graph.observation_landmark_ids, dtype=object)
    seen = names[np.isin(graph.observation_keyframe_ids, around)]
    return np.unique(np.array([row_of[name] for name in seen.tolist()], dtype=np.int64))


def positions_from(condensed: SavedMap, place: int, rows: IntArray) -> FloatArray:
    """Positions (N, 3) m of landmarks in the frame of a place."""
    return apply(invert(condensed.graph.T_map_body[place]), condensed.objects.positions[rows])
