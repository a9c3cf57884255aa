"""A map condensed to few upright places: the observations of a cell of its area, as seen from one keyframe there.

Keyframes stand metres apart and see the same landmarks again and again. Once a map is optimised, one place in each cell
keeps its shape: the observations of a landmark from a cell become one, by the sum of their information. However many
drives there are, the graph is as large as their area.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from logs.messages import FactorGraphRecord
from slam.backend.factors import Edge, EdgeKind, Observation, sum_observations
from slam.backend.graph_record import make_graph_record
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import SUBMAP_RANGES, Config
from slam.common.geometry import apply_each, covariance_in_axes, gravity_frame, invert
from slam.object_map.map_io import SavedMap, are_of_kind


def condense_map(saved: SavedMap, config: Config) -> SavedMap:
    """The same landmarks, observed from one place in each cell, half as long as a submap, that a drive passed.

    The keyframes of the result are these places, upright, numbered from 0. The origin is in the middle of a cell: a
    drive begins there, and a level one would pass both cells on either side of a border. The place nearest to the
    origin comes first: covariances are relative to the first one.
    """
    graph, positions = saved.graph, saved.graph.T_map_body[:, :3, 3]
    cell_m = 0.5 * SUBMAP_RANGES * config.sensor_range_m
    cells, cell = np.unique(np.round(positions / cell_m), axis=0, return_inverse=True)
    outwards = np.argsort(np.linalg.norm(cells, axis=1), kind="stable")
    cell = np.argsort(outwards)[cell.ravel()]
    middles = _middles(cell, positions)
    T_map_place = gravity_frame(graph.T_map_body[middles])
    condensed = make_graph_record(
        graph.stamp_ns,
        np.arange(len(T_map_place)),
        graph.keyframe_stamps_ns[middles],
        T_map_place,
        _edges(graph, cell, T_map_place),
        _observations(saved, cell, T_map_place, cell_m),
        saved.objects.ids.__getitem__,
    )
    return replace(saved, graph=condensed)


def _rows(values: object, wanted: object) -> IntArray:
    """The rows of the ``wanted`` ones among values, all different."""
    return pd.Index(values).get_indexer(pd.Index(wanted))


def _middles(cell: IntArray, positions: FloatArray) -> IntArray:
    """Row of the keyframe (S,) in the middle of those in each cell, by the positions (K, 3) of the keyframes."""
    by_cell = pd.DataFrame(positions).groupby(cell)
    offsets = positions - 0.5 * (by_cell.transform("min") + by_cell.transform("max"))
    return pd.Series(np.linalg.norm(offsets, axis=1)).groupby(cell).idxmin().to_numpy()


def _edges(graph: FactorGraphRecord, cell: IntArray, T_map_place: FloatArray) -> list[Edge]:
    """An edge for each two places that edges of keyframes relate, as uncertain as such an edge repeated all the way.

    The first one counts, of the odometry if there is one.
    """
    keyframes = _rows(graph.keyframe_ids, graph.edge_keyframe_ids.ravel()).reshape(-1, 2)
    ends, is_step = cell[keyframes], are_of_kind(graph, EdgeKind.ODOMETRY)
    is_between = ~are_of_kind(graph, EdgeKind.DISCONTINUITY) & (ends[:, 0] != ends[:, 1])
    rows = np.argsort(~is_step, kind="stable")
    rows = rows[is_between[rows]]
    _, firsts = np.unique(np.sort(ends[rows], axis=1), axis=0, return_index=True)
    found = []
    for row in rows[np.sort(firsts)].tolist():
        first, second = ends[row].tolist()
        T_from_to = invert(T_map_place[first]) @ T_map_place[second]
        R_map_body = graph.T_map_body[keyframes[row, 1], :3, :3]
        covariance = covariance_in_axes(graph.edge_covariances[row], R_map_body.T @ T_map_place[second, :3, :3])
        if is_step[row]:
            lengths_m = np.linalg.norm([T_from_to[:3, 3], graph.edge_transforms[row, :3, 3]], axis=1)
            covariance = covariance * max(lengths_m[0] / max(lengths_m[1], 1e-9), 1.0)
        kind = EdgeKind.ODOMETRY if is_step[row] else EdgeKind.LOOP_CLOSURE
        found.append(Edge(first, second, T_from_to, covariance, kind))
    return found


def _observations(saved: SavedMap, cell: IntArray, T_map_place: FloatArray, cell_m: float) -> list[Observation]:
    """One observation of each landmark from each place of which a keyframe saw it; landmarks by their rows."""
    graph, objects = saved.graph, saved.objects
    keyframes = _rows(graph.keyframe_ids, graph.observation_keyframe_ids)
    landmarks = _rows(objects.ids, graph.observation_landmark_ids)
    places = cell[keyframes]
    T_place_map = invert(T_map_place[places])
    R_place_body = T_place_map[:, :3, :3] @ graph.T_map_body[keyframes, :3, :3]
    positions = apply_each(T_place_map, objects.positions[landmarks])
    # A landmark nearer to a place has no bearing there; the places beside it observe it.
    is_far = np.linalg.norm(positions, axis=1) > 0.02 * cell_m
    covariances = R_place_body @ graph.observation_covariances @ np.swapaxes(R_place_body, 1, 2)
    observed = places, landmarks, positions, covariances, np.ones(len(places))
    summed = sum_observations(*(each[is_far] for each in observed))
    # Between two drives the kernel is as wide as that of one observation.
    return [
        replace(each, covariance=each.covariance_inflation * each.covariance, covariance_inflation=1.0)
        for each in summed
    ]


def place_landmarks(condensed: SavedMap, place: int) -> IntArray:
    """Rows (N,) of the landmarks that were observed from a place and those before and after it on a drive."""
    graph = condensed.graph
    is_driven = are_of_kind(graph, EdgeKind.ODOMETRY)
    beside = graph.edge_keyframe_ids[is_driven & (graph.edge_keyframe_ids == place).any(axis=1)]
    is_seen = np.isin(graph.observation_keyframe_ids, np.append(beside, place))
    seen = np.array(graph.observation_landmark_ids, dtype=object)[is_seen]
    return np.unique(_rows(condensed.objects.ids, seen))
