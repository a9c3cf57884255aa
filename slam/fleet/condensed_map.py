"""A map of a drive condensed to few upright places: the observations of a stretch, as seen from its middle.

Keyframes stand metres apart and see the same landmarks again and again. Once a drive is optimised, a place every
sensor range keeps its shape: the observations of a landmark in a stretch become one, by the sum of their information,
and the steps of the odometry between two places one edge.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd

from logs.messages import FactorGraphRecord
from slam.backend.factors import Edge, EdgeKind, Observation
from slam.backend.graph_record import make_graph_record
from slam.backend.observation_sums import sum_observations
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import SUBMAP_RANGES, Config
from slam.common.geometry import adjoint, covariance_in_axes, invert
from slam.object_map.map_io import SavedMap, are_of_kind
from slam.object_map.submap import gravity_frame


def stretch_length_m(config: Config) -> float:
    """Travel [m] between two places: half of that of a submap."""
    return 0.5 * SUBMAP_RANGES * config.sensor_range_m


def condense_map(saved: SavedMap, *, stretch_m: float) -> SavedMap:
    """The same landmarks, observed from a place in each stretch of ``stretch_m`` of travel.

    The keyframes of the result are these places, upright, numbered from 0 along the drive; edges of kind odometry lead
    from each to the next one, those of kind closure are loop closures between stretches.
    """
    graph = saved.graph
    rows = _rows(graph.keyframe_ids, graph.edge_keyframe_ids.ravel()).reshape(-1, 2)
    is_step = are_of_kind(graph, EdgeKind.ODOMETRY) & (rows[:, 1] == rows[:, 0] + 1)
    steps = np.full(len(graph.keyframe_ids), -1, dtype=np.int64)
    steps[rows[is_step, 1]] = np.flatnonzero(is_step)
    travel_m = np.zeros(len(steps))
    travel_m[steps >= 0] = np.linalg.norm(graph.edge_transforms[steps[steps >= 0], :3, 3], axis=1)
    travel_m = np.cumsum(travel_m)
    begins = np.flatnonzero(steps < 0)
    drive = np.cumsum(steps < 0) - 1
    travel_m -= travel_m[begins][drive]
    stretch = np.unique(np.column_stack([drive, travel_m // stretch_m]), axis=0, return_inverse=True)[1].ravel()
    return _condense(saved, stretch, travel_m[:, None], steps, stretch_m)


def condense_area(saved: SavedMap, *, stretch_m: float) -> SavedMap:
    """The same landmarks, observed from one place in each cell of ``stretch_m`` that a drive passed.

    However many drives there are, the graph is as large as their area; its edges are all of kind closure. The origin is
    in the middle of a cell: a drive begins there, and a level one would pass both cells on either side of a border.
    The place nearest to the origin comes first: covariances are relative to the first one.
    """
    positions = saved.graph.T_map_body[:, :3, 3]
    cells, cell = np.unique(np.round(positions / stretch_m), axis=0, return_inverse=True)
    outwards = np.argsort(np.linalg.norm(cells, axis=1), kind="stable")
    cell = np.argsort(outwards)[cell.ravel()]
    no_steps = np.full(len(cell), -1, dtype=np.int64)
    return _condense(saved, cell, positions, no_steps, stretch_m)


def _rows(values: object, wanted: object) -> IntArray:
    """The rows of the ``wanted`` ones among values, all different."""
    return np.asarray(pd.Index(values).get_indexer(pd.Index(wanted)), dtype=np.int64)


def _middles(stretch: IntArray, coordinates: FloatArray) -> IntArray:
    """Row of the keyframe (S,) in the middle of each stretch, by the coordinates (K, D) of the keyframes."""
    middles = []
    for number in range(int(stretch.max()) + 1):
        rows = np.flatnonzero(stretch == number)
        at = coordinates[rows]
        offsets = at - 0.5 * (at.min(axis=0) + at.max(axis=0))
        middles.append(rows[np.linalg.norm(offsets, axis=1).argmin()])
    return np.array(middles, dtype=np.int64)


def _condense(
    saved: SavedMap, stretch: IntArray, coordinates: FloatArray, steps: IntArray, stretch_m: float
) -> SavedMap:
    """The map by the ``stretch`` (K,) and the ``coordinates`` (K, D) of each keyframe, and the edge of the odometry to
    it from the one before it, ``steps`` (K,), -1 where there is none.
    """
    graph, middles = saved.graph, _middles(stretch, coordinates)
    T_map_place = gravity_frame(graph.T_map_body[middles])
    condensed = make_graph_record(
        graph.stamp_ns,
        np.arange(len(T_map_place)),
        graph.keyframe_stamps_ns[middles],
        T_map_place,
        [*_edges(graph, stretch, middles, steps, T_map_place), *_observations(saved, stretch, T_map_place, stretch_m)],
        saved.objects.ids.__getitem__,
        np.zeros((0, 6, 6)),
    )
    return replace(saved, graph=condensed)


def _edges(
    graph: FactorGraphRecord, stretch: IntArray, middles: IntArray, steps: IntArray, T_map_place: FloatArray
) -> list[Edge]:
    """Edges between places, numbered from 0: those of the odometry, and one for each two that other edges relate."""
    found: dict[tuple[int, int], tuple[FloatArray, EdgeKind]] = {}
    for place, (first, last) in enumerate(pairwise(middles.tolist())):
        between = steps[first + 1 : last + 1]
        if len(between) and between.min() >= 0:
            found[place, place + 1] = _composed(graph, between, last), EdgeKind.ODOMETRY
    is_between = are_of_kind(graph, EdgeKind.ODOMETRY) | are_of_kind(graph, EdgeKind.LOOP_CLOSURE)
    ends = stretch[_rows(graph.keyframe_ids, graph.edge_keyframe_ids.ravel())].reshape(-1, 2)
    for edge in np.flatnonzero(is_between & (ends[:, 0] != ends[:, 1])).tolist():
        first, second = ends[edge].tolist()
        found.setdefault((first, second), (graph.edge_covariances[edge], EdgeKind.LOOP_CLOSURE))
    return [
        Edge(first, second, invert(T_map_place[first]) @ T_map_place[second], covariance, kind)
        for (first, second), (covariance, kind) in found.items()
    ]


def _composed(graph: FactorGraphRecord, steps: IntArray, last: int) -> FloatArray:
    """Covariance (6, 6) of a chain of edges, in the upright frame of its last keyframe, row ``last``."""
    P = np.zeros((6, 6))
    for step in steps:
        A = adjoint(invert(graph.edge_transforms[step]))
        P = A @ P @ A.T + graph.edge_covariances[step]
    T_map_body = graph.T_map_body[last]
    return covariance_in_axes(P, T_map_body[:3, :3].T @ gravity_frame(T_map_body)[:3, :3])


def _observations(saved: SavedMap, stretch: IntArray, T_map_place: FloatArray, stretch_m: float) -> list[Observation]:
    """One observation of each landmark from each place of which a keyframe saw it; landmarks by their rows."""
    graph, objects = saved.graph, saved.objects
    keyframes = _rows(graph.keyframe_ids, graph.observation_keyframe_ids)
    landmarks = _rows(objects.ids, graph.observation_landmark_ids)
    places = stretch[keyframes]
    T_place_map = invert(T_map_place[places])
    R_place_body = T_place_map[:, :3, :3] @ graph.T_map_body[keyframes, :3, :3]
    positions = np.einsum("nij,nj->ni", T_place_map[:, :3, :3], objects.positions[landmarks]) + T_place_map[:, :3, 3]
    # A landmark nearer to a place has no bearing there; the places beside it observe it.
    is_far = np.linalg.norm(positions, axis=1) > 0.02 * stretch_m
    covariances = R_place_body @ graph.observation_covariances @ np.swapaxes(R_place_body, 1, 2)
    summed = sum_observations(
        places[is_far], landmarks[is_far], positions[is_far], covariances[is_far], np.ones(np.count_nonzero(is_far))
    )
    # Between two drives the kernel is as wide as that of one observation.
    return [
        replace(each, covariance=each.covariance_inflation * each.covariance, covariance_inflation=1.0)
        for each in summed
    ]


def place_landmarks(condensed: SavedMap, place: int) -> IntArray:
    """Rows (N,) of the landmarks that were observed from a place and those before and after it on its drive."""
    graph = condensed.graph
    is_driven = are_of_kind(graph, EdgeKind.ODOMETRY)
    beside = graph.edge_keyframe_ids[is_driven & (graph.edge_keyframe_ids == place).any(axis=1)]
    is_seen = np.isin(graph.observation_keyframe_ids, np.append(beside, place))
    seen = np.array(graph.observation_landmark_ids, dtype=object)[is_seen]
    return np.unique(_rows(condensed.objects.ids, seen))
