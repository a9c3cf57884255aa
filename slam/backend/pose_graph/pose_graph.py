"""A pose graph: vertices, and the edges that tie them together; plain arrays that know no solver and no file."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.errors import InputDataError
from slam.common.union_find import UnionFind, find_components

MAX_NAMED = 5


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Poses in the plane (D = 2, K = 3 degrees of freedom) or in space (D = 3, K = 6), metres and radians.

    vertex_ids (V,) unique; T_world_vertex (V, D + 1, D + 1).
    edges (E, 2): the ids (from, to) of each; T_from_to (E, D + 1, D + 1); information (E, K, K), the inverse of the
    covariance in GTSAM's order: x, y, yaw in the plane, and rotation before translation in space.
    fixed_ids (F,): vertices that stay where they are; F may be 0.
    """

    vertex_ids: IntArray
    T_world_vertex: FloatArray
    edges: IntArray
    T_from_to: FloatArray
    information: FloatArray
    fixed_ids: IntArray

    @property
    def is_planar(self) -> bool:
        """Whether the poses lie in the plane."""
        return bool(self.T_world_vertex.shape[-1] == 3)

    def rows_of(self, vertex_ids: IntArray) -> IntArray:
        """Rows (N,) in ``vertex_ids`` of the given ids (N,), which must all be there."""
        order = np.argsort(self.vertex_ids)
        return np.asarray(order[np.searchsorted(self.vertex_ids, vertex_ids, sorter=order)])

    def find_neighbours(self) -> BoolArray:
        """Whether the ids of each edge (E,) follow one another among all ids, in either direction."""
        places = np.searchsorted(np.sort(self.vertex_ids), self.edges)
        return np.asarray(np.abs(places[:, 1] - places[:, 0]) == 1)

    def find_closures(self) -> BoolArray:
        """Whether each edge (E,) closes a loop.

        Edges between ids that follow one another among all ids, in either direction, are odometry. Where these leave
        parts apart, e.g. the drives of two robots, the first edge in the file that joins two parts is taken as given,
        too. All others are closures.
        """
        closures = ~self.find_neighbours()
        ends = self.rows_of(self.edges).tolist()
        parts = UnionFind()
        for row in np.flatnonzero(~closures):
            parts.merge(*ends[row])
        for row in np.flatnonzero(closures):
            closures[row] = not parts.merge(*ends[row])
        return np.asarray(closures)


def make_pose_graph(
    vertices: Mapping[int, FloatArray],
    edges: IntArray,
    T_from_to: FloatArray,
    information: FloatArray,
    fixed_ids: IntArray,
    name_edge: Callable[[int], str] = "edge {}".format,
) -> PoseGraph:
    """A connected graph; vertices without a pose are placed along the edges between consecutive ids.

    Where none has a pose, the least id is the origin.

    Args:
        vertices: ``T_world_vertex`` (D + 1, D + 1) by id; the ids of others are those that edges name.
        edges: (E, 2), T_from_to (E, D + 1, D + 1), information (E, K, K) as in :class:`PoseGraph`; E >= 1.
        T_from_to: see above.
        information: see above.
        fixed_ids: (F,), all of them vertices.
        name_edge: how errors name an edge, by its row.

    Raises:
        InputDataError: the graph falls into parts, or no chain leads to a vertex without a pose.
    """
    missing = sorted({*edges.ravel().tolist()} - vertices.keys())
    vertex_ids = np.array([*vertices, *missing], dtype=np.int64)
    poses = np.full((len(vertex_ids), *T_from_to.shape[1:]), np.nan)
    poses[: len(vertices)] = np.array(list(vertices.values())).reshape(-1, *T_from_to.shape[1:])
    graph = PoseGraph(vertex_ids, poses, edges, T_from_to, information, fixed_ids)
    _check_connected(graph)
    if missing:
        _place(graph, name_edge)
    return graph


def _check_connected(graph: PoseGraph) -> None:
    roots = find_components(len(graph.vertex_ids), graph.rows_of(graph.edges))
    apart = np.sort(graph.vertex_ids[roots != np.bincount(roots).argmax()])
    if len(apart):
        more = f" and {len(apart) - MAX_NAMED} more" if len(apart) > MAX_NAMED else ""
        named = ", ".join(map(str, apart[:MAX_NAMED].tolist()))
        raise InputDataError(
            f"the graph is not connected: no edges lead from vertex {named}{more} to the other "
            f"{len(roots) - len(apart)}; add edges, or remove these vertices"
        )


def _place(graph: PoseGraph, name_edge: Callable[[int], str]) -> None:
    """Give the vertices without a pose one, in place."""
    poses = graph.T_world_vertex
    placed = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
    if placed.any():  # Only neighbours are safe: another id without a vertex may be a slip of the pen.
        chain = np.flatnonzero(graph.find_neighbours())
    else:
        chain = np.flatnonzero(~graph.find_closures())
        origin = int(np.argmin(graph.vertex_ids))
        poses[origin], placed[origin] = np.eye(poses.shape[1]), True
    steps: dict[int, list[tuple[int, FloatArray]]] = {}
    for edge, (start, end) in zip(chain, graph.rows_of(graph.edges[chain]).tolist(), strict=True):
        steps.setdefault(start, []).append((end, graph.T_from_to[edge]))
        steps.setdefault(end, []).append((start, np.linalg.inv(graph.T_from_to[edge])))
    waiting = deque[int](np.flatnonzero(placed)[np.argsort(graph.vertex_ids[placed])].tolist())
    while waiting:
        here = waiting.popleft()
        for other, T_here_other in steps.get(here, []):
            if not placed[other]:
                poses[other], placed[other] = poses[here] @ T_here_other, True
                waiting.append(other)
    if not placed.all():
        lost = int(graph.vertex_ids[np.argmin(placed)])
        naming = int(np.flatnonzero((graph.edges == lost).any(axis=1))[0])
        raise InputDataError(
            f"{name_edge(naming)}: vertex {lost} is not in the graph, and no chain of edges between consecutive ids "
            "leads to it; add the vertex, or correct the id"
        )
