"""One map of several: their places optimised with the joins, landmarks fused, and all of it optimised together."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.backend.graph_record import edges_of, observations_of
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import apply_each, invert, pose_errors, relative, squared_mahalanobis
from slam.fleet.joins import Join
from slam.fleet.part import Part, Visit, common_metadata
from slam.loop_closure.landmark_fusion import fuse_landmarks
from slam.object_map.landmarks import ObjectMap
from slam.object_map.map_io import SavedMap, confirmed, observing

MAX_DEVIATIONS = 7.0
"""Standard deviations; a join that is farther off the solution of all, which its robust kernel allows, is false."""


class _Group:
    """Some parts, by their numbers, with the joins between them.

    Their places are numbered in the order of the parts: ``numbers`` (K,), part of each.
    """

    def __init__(self, parts: Sequence[Part], chosen: Sequence[int], joins: Sequence[Join]) -> None:
        self.parts = {number: parts[number] for number in chosen}
        self.joins = [join for join in joins if join.query_map in chosen]
        self.numbers = np.repeat(chosen, [len(part.saved.graph.keyframe_ids) for part in self.parts.values()])

    def rows(self, number: int) -> IntArray:
        """Numbers (P,) of the places of a part."""
        return np.flatnonzero(self.numbers == number)

    def places(self, number: int) -> dict[int, int]:
        """The number of each place of a part, by its id there, which is its row."""
        return dict(enumerate(self.rows(number).tolist()))

    def edges(self) -> list[Edge]:
        """Edges within the parts."""
        parts = self.parts.items()
        return [edge for number, part in parts for edge in edges_of(part.saved.graph, self.places(number))]

    def closures(self) -> list[Edge]:
        """Edges of the joins, each from the nearest place of the reference map to the recognised place."""
        found = []
        for join in self.joins:
            T_reference = self.parts[join.reference_map].saved.graph.T_map_body
            offsets = T_reference[:, :2, 3] - join.T_reference_place[:2, 3]
            nearest = np.linalg.norm(offsets, axis=1).argmin()
            T_from_to = invert(T_reference[nearest]) @ join.T_reference_place
            ends = self.rows(join.reference_map)[nearest], self.rows(join.query_map)[join.place]
            found.append(Edge(int(ends[0]), int(ends[1]), T_from_to, join.covariance, EdgeKind.LOOP_CLOSURE))
        return found


def join_parts(parts: Sequence[Part], joins: Sequence[Join], config: Config) -> list[Part]:
    """The parts that are left when they are joined; that of most sessions first.

    Args:
        parts: numbered in their order.
        joins: those that are accepted.
        config: of the optimisation and the fusion.

    Raises:
        FactorGraphError: GTSAM cannot solve it.
    """
    T_joint_map = _chained(len(parts), joins)
    joined = []
    for related in _connected(range(len(parts)), joins):
        group = _Group(parts, related, joins)
        T_map_place, agreeing = _placed(group, T_joint_map, config.sensor_range_m)
        for members in _connected(related, agreeing):
            kept, T = _Group(parts, members, agreeing), T_map_place[np.isin(group.numbers, members)]
            joined.append(_solved(kept, T, config) if kept.joins else parts[members[0]])
    return sorted(joined, key=lambda part: (-len(part.visits), part.sessions))


def _connected(numbers: Sequence[int], joins: Sequence[Join]) -> list[list[int]]:
    """The numbers of maps in groups that joins connect."""
    ends = np.array([join.maps for join in joins], dtype=np.int64).reshape(-1, 2)
    pairs = coo_array((np.ones(len(ends)), np.searchsorted(numbers, ends).T), shape=(len(numbers), len(numbers)))
    component = connected_components(pairs, directed=False)[1]
    return [np.asarray(numbers)[component == each].tolist() for each in np.unique(component)]


def _placed(group: _Group, T_joint_map: FloatArray, sensor_range_m: float) -> tuple[FloatArray, list[Join]]:
    """Poses (K, 4, 4) of all places by the edges within the maps and by joins, without landmarks, and the joins that
    agree with them; maps begin at ``T_joint_map`` (M, 4, 4).
    """
    poses = np.concatenate([T_joint_map[number] @ part.saved.graph.T_map_body for number, part in group.parts.items()])
    closures = group.closures()
    if not closures:
        return poses, []
    graph = FactorGraph(sensor_range_m=sensor_range_m)
    graph.restore(poses, [*group.edges(), *closures], [])
    graph.optimize()
    poses = graph.poses()
    T_from, T_to = (poses[[getattr(edge, end) for edge in closures]] for end in ("from_keyframe", "to_keyframe"))
    errors = pose_errors(np.array([edge.T_from_to for edge in closures]), relative(T_from, T_to))
    agree = squared_mahalanobis(errors, np.array([edge.covariance for edge in closures])) <= MAX_DEVIATIONS**2
    return poses, list(compress(group.joins, agree.tolist()))


def _chained(count: int, joins: Sequence[Join]) -> FloatArray:
    """``T_joint_map`` (M, 4, 4) of maps along the pairs that most places relate, each by its surest join."""
    costs = np.zeros((count, count))
    costs[0, 1:] = 1.0  # so that maps that no join relates are in the tree, where they are
    T_between = {}
    for join in sorted(joins, key=lambda join: join.log_odds):
        costs[join.maps] = min(costs[join.maps], 0.0) - join.log_odds
        T_between[join.maps], T_between[join.maps[::-1]] = join.T_reference_query, invert(join.T_reference_query)
    order, previous = breadth_first_order(minimum_spanning_tree(costs), 0, directed=False)
    T_joint_map = np.tile(np.eye(4), (count, 1, 1))
    for row in order[1:].tolist():
        T_joint_map[row] = T_joint_map[previous[row]] @ T_between.get((previous[row], row), np.eye(4))
    return T_joint_map


def _solved(group: _Group, T_map_place: FloatArray, config: Config) -> Part:
    """All places and landmarks of parts whose places are at ``T_map_place`` already, estimated together."""
    object_map = ObjectMap(config.calibration.objects)
    graph = FactorGraph(sensor_range_m=config.sensor_range_m)
    rows_of, observations = dict[int, IntArray](), []
    for number, part in group.parts.items():
        positions, R = _moved(part.saved, T_map_place[group.rows(number)], part.objects.positions)
        covariances = R @ part.objects.covariances @ np.swapaxes(R, 1, 2)
        carried = replace(part.objects, positions=positions, covariances=covariances)
        rows_of[number] = object_map.restore(carried, travel_m=0.0)
        landmark_of = dict(zip(part.objects.ids, rows_of[number].tolist(), strict=True))
        observations += observations_of(part.saved.graph, group.places(number), landmark_of)
    graph.restore(T_map_place, [*group.edges(), *group.closures()], observations)
    _merge_matched(object_map, group.joins, rows_of)
    graph.alias_landmarks(object_map.aliases)
    graph.optimize()
    if fuse_landmarks(object_map, graph, config.calibration.objects):
        graph.optimize()
    landmarks, covariances = graph.landmarks, graph.covariances()[1]
    object_map.assign(landmarks, position_map=graph.landmark_positions(landmarks), covariance_map=covariances)
    stamps_ns = np.concatenate([part.saved.graph.keyframe_stamps_ns for part in group.parts.values()])
    objects = confirmed(object_map.to_record(int(stamps_ns.max())))
    record = observing(graph.to_record(objects.stamp_ns, stamps_ns), objects, np.ones(len(stamps_ns), dtype=np.bool_))
    joint = SavedMap(objects, record, common_metadata(part.saved for part in group.parts.values()))
    row_of = {int(name): row for row, name in enumerate(objects.ids)}
    visits = {}
    for number, part in group.parts.items():
        for session, visit in part.visits.items():
            points, _ = _moved(part.saved, record.T_map_body[group.rows(number)], visit.steps.reshape(-1, 3))
            rows = [row_of[row] for row in object_map.canonical[rows_of[number][visit.landmarks]].tolist()]
            visits[session] = Visit(points.reshape(visit.steps.shape), np.unique(np.array(rows, dtype=np.int64)))
    return Part(joint, visits)


def _moved(saved: SavedMap, T_joint_place: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) m of a map as they move along with its nearest places, which are at (K, 4, 4) now.

    Returns:
        The points in the joint map, and the rotations (N, 3, 3) that they took part in.
    """
    nearest = cKDTree(saved.graph.T_map_body[:, :3, 3]).query(points)[1]
    T = (T_joint_place @ invert(saved.graph.T_map_body))[nearest]
    return apply_each(T, points), T[:, :3, :3]


def _merge_matched(object_map: ObjectMap, joins: Sequence[Join], rows_of: Mapping[int, IntArray]) -> None:
    """Merge the landmarks that joins matched, the surest first; two landmarks of one map are two objects."""
    maps_of = {row: {number} for number, rows in rows_of.items() for row in rows.tolist()}
    for join in sorted(joins, key=lambda join: -join.log_odds):
        queries, references = join.pairs.T
        for ends in zip(rows_of[join.query_map][queries], rows_of[join.reference_map][references], strict=True):
            kept, dropped = sorted(object_map.canonical[list(ends)].tolist())
            if maps_of[kept].isdisjoint(maps_of[dropped]):
                object_map.merge(kept, dropped)
                maps_of[kept] |= maps_of[dropped]
