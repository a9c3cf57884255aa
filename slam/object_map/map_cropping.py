"""A part of a saved map: the landmarks and keyframes in an area, still tied together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from logs.messages import FactorGraphRecord
from slam.backend.edge_kind import EdgeKind
from slam.common.areas import Area
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import SavedMapError
from slam.common.geometry import adjoint, invert
from slam.object_map.map_io import SavedMap, are_of_kind, observing, of_rows
from slam.object_map.map_validation import parts


def crop_map(saved: SavedMap, area: Area) -> SavedMap:
    """The landmarks and keyframes of a map that lie in an area; their places stay what they are.

    Where the drive left the area and came back, what lay between becomes one edge: the relative pose that the map has,
    with the covariance of the edges on the most exact way there.

    Raises:
        SavedMapError: no landmark, or no keyframe, lies in it.
    """
    objects, graph = saved.objects, saved.graph
    landmarks, keyframes = area.contains(objects.positions), area.contains(graph.T_map_body[:, :3, 3])
    if not landmarks.any() or not keyframes.any():
        low, high = objects.positions[:, :2].min(axis=0), objects.positions[:, :2].max(axis=0)
        raise SavedMapError(
            f"{np.count_nonzero(landmarks)} of {len(landmarks)} landmarks and {np.count_nonzero(keyframes)} of "
            f"{len(keyframes)} keyframes lie in that area, and a map needs both; the map extends from "
            f"({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f}) m"
        )
    kept = of_rows(objects, landmarks)
    return replace(saved, objects=kept, graph=_bridged(graph, observing(graph, kept, keyframes)))


def _bridged(whole: FactorGraphRecord, cropped: FactorGraphRecord) -> FactorGraphRecord:
    """The cropped graph with an edge between any two parts of it that hung together only by what is gone."""
    edges = _WeightedEdges(whole)
    while (part := parts(cropped, ~are_of_kind(cropped, EdgeKind.DISCONTINUITY))).any():
        first, other = cropped.keyframe_ids[part == 0], cropped.keyframe_ids[part != 0]
        start, end, covariance = edges.shortest(first, other)
        T_map_start, T_map_end = edges.pose(start), edges.pose(end)
        cropped = replace(
            cropped,
            edge_keyframe_ids=np.concatenate([cropped.edge_keyframe_ids, [[start, end]]]),
            edge_transforms=np.concatenate([cropped.edge_transforms, (invert(T_map_start) @ T_map_end)[None]]),
            edge_covariances=np.concatenate([cropped.edge_covariances, covariance[None]]),
            edge_kinds=(*cropped.edge_kinds, str(EdgeKind.LOOP_CLOSURE)),
        )
    return cropped


class _WeightedEdges:
    """The edges of a graph that hold information, as ways between its keyframes, weighted by their variance."""

    def __init__(self, graph: FactorGraphRecord) -> None:
        self._graph = graph
        self._row_of = {int(keyframe): row for row, keyframe in enumerate(graph.keyframe_ids)}
        self._edges = np.flatnonzero(~are_of_kind(graph, EdgeKind.DISCONTINUITY))
        ends = [[self._row_of[int(k)] for k in graph.edge_keyframe_ids[edge]] for edge in self._edges]
        self._ends = np.array(ends, dtype=np.int64).reshape(-1, 2)
        self._variances = np.trace(graph.edge_covariances[self._edges][:, 3:, 3:], axis1=1, axis2=2)
        count = len(self._row_of)
        # Of parallel edges the most exact comes first; csr_array would add them up.
        order = np.argsort(self._variances, kind="stable")
        _, unique = np.unique(np.sort(self._ends[order], axis=1), axis=0, return_index=True)
        used = order[unique]
        self._used = {frozenset(self._ends[row].tolist()): int(row) for row in used}
        weights = np.maximum(self._variances[used], np.finfo(np.float64).tiny)
        self._matrix = csr_array((weights, (self._ends[used, 0], self._ends[used, 1])), shape=(count, count))

    def pose(self, keyframe: int) -> FloatArray:
        """``T_map_body`` (4, 4)."""
        return np.asarray(self._graph.T_map_body[self._row_of[keyframe]])

    def shortest(self, first: IntArray, other: IntArray) -> tuple[int, int, FloatArray]:
        """The ends of the most exact way from keyframes (A,) to others (B,), and the covariance (6, 6) along it."""
        sources = [self._row_of[int(keyframe)] for keyframe in first]
        targets = np.array([self._row_of[int(keyframe)] for keyframe in other])
        reached, before, _ = dijkstra(
            self._matrix, directed=False, indices=sources, min_only=True, return_predecessors=True
        )
        row = end = int(targets[np.argmin(reached[targets])])
        T_map_end, covariance = self._graph.T_map_body[end], np.zeros((6, 6))
        while before[row] >= 0:
            edge = self._used[frozenset((row, int(before[row])))]
            # An edge's covariance is in the axes of the keyframe that it leads to.
            at = self._graph.T_map_body[self._ends[edge, 1]]
            Ad = adjoint(invert(T_map_end) @ at)
            covariance += Ad @ self._graph.edge_covariances[self._edges[edge]] @ Ad.T
            row = int(before[row])
        ids = self._graph.keyframe_ids
        return int(ids[row]), int(ids[end]), 0.5 * (covariance + covariance.T)
