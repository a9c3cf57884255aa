"""One map of several: a robust pose graph of their places, landmarks fused, and all of it optimised together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from logs.messages import ObjectMapRecord
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind, Observation
from slam.backend.graph_record import edges_of, observations_of
from slam.backend.pose_graph.pose_graph import PoseGraph
from slam.backend.pose_graph.pose_graph_optimization import optimize_pose_graph
from slam.backend.solver_options import FactorGraphConfig
from slam.common.arrays import BoolArray, FloatArray
from slam.common.config import Config
from slam.common.geometry import invert
from slam.common.union_find import UnionFind, find_components
from slam.loop_closure.landmark_fusion import fuse_duplicate_landmarks
from slam.map_joining.acceptance import MapPair
from slam.map_joining.joins import Join
from slam.map_joining.part import Part
from slam.map_joining.session_config import common_metadata
from slam.object_map.landmarks import ObjectMap
from slam.object_map.map_io import SavedMap, confirmed, observing

TIE_SIGMA_RAD, TIE_SIGMA_PITCHES = 10.0, 10.0
"""Of the edges that place one map beside another before any join is weighed, in radians and extents of the maps."""
FUSIONS = 3
"""Rounds of fusing landmarks and optimising: better positions show more duplicates."""


def join_parts(parts: Sequence[Part], pairs: Sequence[MapPair], config: Config) -> list[Part]:
    """The parts that are left when those of accepted pairs are joined; that of most sessions first.

    Args:
        parts: numbered in their order.
        pairs: verdicts on pairs of them; those that were not accepted join nothing.
        config: of the optimisation and the fusion.

    Raises:
        FactorGraphError: GTSAM cannot solve it.
    """
    accepted = sorted((pair for pair in pairs if pair.accepted), key=lambda pair: (pair.first, pair.second))
    groups = _connected(list(range(len(parts))), [(pair.first, pair.second) for pair in accepted])
    joined = [
        part for group in groups for part in _join(group, parts, [p for p in accepted if p.first in group], config)
    ]
    return sorted(joined, key=lambda part: (-len(part.paths), part.sessions))


def _join(group: list[int], parts: Sequence[Part], pairs: list[MapPair], config: Config) -> list[Part]:
    maps = [part.saved for part in parts]
    first = _first_places(group, maps)
    joins = [join for pair in pairs for join in pair.joins]
    if not joins:
        return [_solved([each], parts, [], [], maps[each].graph.T_map_body, config) for each in group]
    T_map_place, kept = _placed(group, maps, pairs, joins, first)
    held = [join for join, is_kept in zip(joins, kept, strict=True) if is_kept]
    rejected = [join for join, is_kept in zip(joins, kept, strict=True) if not is_kept]
    members = _connected(group, [(join.query_map, join.reference_map) for join in held])
    return [
        _solved(
            each,
            parts,
            [join for join in held if join.query_map in each],
            [join for join in rejected if join.query_map in each],
            np.concatenate([T_map_place[_rows(number, maps, first)] for number in each])
            if len(each) > 1
            else maps[each[0]].graph.T_map_body,
            config,
        )
        for each in members
    ]


def _connected(numbers: list[int], ties: Sequence[tuple[int, int]]) -> list[list[int]]:
    row_of = {number: row for row, number in enumerate(numbers)}
    ends = np.array([(row_of[a], row_of[b]) for a, b in ties], dtype=np.int64).reshape(-1, 2)
    component = find_components(len(numbers), ends)
    return [[numbers[row] for row in np.flatnonzero(component == each)] for each in np.unique(component)]


def _first_places(group: Sequence[int], maps: Sequence[SavedMap]) -> dict[int, int]:
    """Number of the first place of each map, when those of all maps are numbered in their order."""
    counts = [len(maps[number].graph.keyframe_ids) for number in group]
    return dict(zip(group, np.cumsum([0, *counts[:-1]]).tolist(), strict=True))


def _rows(number: int, maps: Sequence[SavedMap], first: Mapping[int, int]) -> slice:
    return slice(first[number], first[number] + len(maps[number].graph.keyframe_ids))


def _placed(
    group: list[int], maps: Sequence[SavedMap], pairs: list[MapPair], joins: list[Join], first: Mapping[int, int]
) -> tuple[FloatArray, BoolArray]:
    """Poses (K, 4, 4) of all places in the frame of the first map, and which joins (J,) agree with them."""
    T_joint_map = _chained(group, maps, pairs)
    poses = np.concatenate([T_joint_map[number] @ maps[number].graph.T_map_body for number in group])
    extent_m = float(np.ptp(poses[:, :2, 3], axis=0).max()) + 1.0
    loose = np.diag(np.repeat([TIE_SIGMA_RAD, TIE_SIGMA_PITCHES * extent_m], 3) ** 2.0)
    edges = [edge for number in group for edge in edges_of(maps[number].graph, _places(number, maps, first))]
    for number in group[1:]:
        start, end = first[group[0]], first[number]
        edges.append(Edge(start, end, invert(poses[start]) @ poses[end], loose, EdgeKind.LOOP_CLOSURE))
    is_closure = np.repeat([False, True], [len(edges), len(joins)])
    edges += [_closure(join, maps, first) for join in joins]
    pose_graph = PoseGraph(
        T_world_vertex=poses,
        edges=np.array([(edge.from_keyframe, edge.to_keyframe) for edge in edges], dtype=np.int64),
        T_from_to=np.array([edge.T_from_to for edge in edges]),
        covariances=np.array([edge.covariance for edge in edges]),
    )
    solved = optimize_pose_graph(pose_graph, is_closure)
    return solved.graph.T_world_vertex, solved.solution.kept


def _chained(group: list[int], maps: Sequence[SavedMap], pairs: list[MapPair]) -> dict[int, FloatArray]:
    """``T_joint_map`` (4, 4) of each map, along the pairs with the highest log odds that relate all maps."""
    T_joint_map, related = {group[0]: np.eye(4)}, UnionFind()
    tree = [pair for pair in sorted(pairs, key=lambda pair: -pair.log_odds) if related.merge(pair.first, pair.second)]
    while len(T_joint_map) < len(group):
        pair = next(p for p in tree if (p.first in T_joint_map) != (p.second in T_joint_map))
        join = pair.best
        T_reference_query = join.T_reference_place @ invert(maps[join.query_map].graph.T_map_body[join.place])
        if join.reference_map in T_joint_map:
            T_joint_map[join.query_map] = T_joint_map[join.reference_map] @ T_reference_query
        else:
            T_joint_map[join.reference_map] = T_joint_map[join.query_map] @ invert(T_reference_query)
    return T_joint_map


def _closure(join: Join, maps: Sequence[SavedMap], first: Mapping[int, int]) -> Edge:
    """From the nearest place of the reference map to the recognised place."""
    T_reference = maps[join.reference_map].graph.T_map_body
    offsets = T_reference[:, :2, 3] - join.T_reference_place[:2, 3]
    nearest = int(np.hypot(offsets[:, 0], offsets[:, 1]).argmin())
    T_from_to = invert(T_reference[nearest]) @ join.T_reference_place
    ends = first[join.reference_map] + nearest, first[join.query_map] + join.place
    return Edge(*ends, T_from_to, join.covariance, EdgeKind.LOOP_CLOSURE)


def _places(number: int, maps: Sequence[SavedMap], first: Mapping[int, int]) -> dict[int, int]:
    """The joint number of each place of a map."""
    return {place: first[number] + row for row, place in enumerate(maps[number].graph.keyframe_ids.tolist())}


def _carry_along(saved: SavedMap, T_joint_place: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) m of a map as they move along with its nearest places, which are at (K, 4, 4) now.

    Returns:
        The points in the joint map, and the rotations (N, 3, 3) that they took part in.
    """
    nearest = cKDTree(saved.graph.T_map_body[:, :3, 3]).query(points)[1]
    T = (T_joint_place @ invert(saved.graph.T_map_body))[nearest]
    R = T[:, :3, :3]
    return np.einsum("nij,nj->ni", R, points) + T[:, :3, 3], R


def _moved(saved: SavedMap, T_joint_place: FloatArray) -> ObjectMapRecord:
    """The landmarks of a map as they move along with its nearest places, which are at (K, 4, 4) now."""
    positions, R = _carry_along(saved, T_joint_place, saved.objects.positions)
    return replace(saved.objects, positions=positions, covariances=R @ saved.objects.covariances @ np.swapaxes(R, 1, 2))


def _merge_matched(object_map: ObjectMap, joins: Sequence[Join], rows_of: Mapping[int, Mapping[str, int]]) -> None:
    """Merge the landmarks that joins matched, the surest first; two landmarks of one map are two objects."""
    maps_of = {row: {number} for number, rows in rows_of.items() for row in rows.values()}
    for join in sorted(joins, key=lambda join: -join.llr):
        for query, reference in join.pairs:
            ends = rows_of[join.query_map][query], rows_of[join.reference_map][reference]
            kept, dropped = sorted(map(object_map.canonical_id, ends))
            if maps_of[kept].isdisjoint(maps_of[dropped]):
                object_map.merge(kept, dropped)
                maps_of[kept] |= maps_of[dropped]


def _solved(
    members: list[int],
    parts: Sequence[Part],
    joins: list[Join],
    rejected: list[Join],
    T_map_place: FloatArray,
    config: Config,
) -> Part:
    """All places and landmarks of parts whose places are at ``T_map_place`` already, estimated together."""
    maps = [part.saved for part in parts]
    first = _first_places(members, maps)
    place_maps = np.repeat(members, [len(maps[number].graph.keyframe_ids) for number in members])
    object_map = ObjectMap(config.calibration.objects)
    graph = FactorGraph(FactorGraphConfig(), sensor_range_m=config.sensor_range_m)
    rows_of: dict[int, dict[str, int]] = {}
    edges, observations = list[Edge](), list[Observation]()
    for number in members:
        saved = maps[number]
        rows = object_map.restore(_moved(saved, T_map_place[place_maps == number]), travel_m=0.0)
        rows_of[number] = dict(zip(saved.objects.ids, rows.tolist(), strict=True))
        place_of = _places(number, maps, first)
        edges += edges_of(saved.graph, place_of)
        observations += observations_of(saved.graph, place_of, rows_of[number])
    edges += [_closure(join, maps, first) for join in joins]
    graph.restore(T_map_place, edges, observations)
    _merge_matched(object_map, joins, rows_of)
    graph.alias_landmarks(object_map.aliases)
    radius_m = 2.0 * config.calibration.objects.landmark_sigma_m
    for _ in range(FUSIONS):
        graph.optimize()
        if not fuse_duplicate_landmarks(
            object_map, graph, range(len(T_map_place)), radius_m=radius_m, drives=place_maps
        ):
            break
    else:
        graph.optimize()
    stamps_ns = np.concatenate([maps[number].graph.keyframe_stamps_ns for number in members])
    stamp_ns = int(stamps_ns.max())
    in_graph = graph.landmarks
    object_map.assign(
        in_graph,
        position_map=graph.landmark_positions(in_graph),
        covariance_map=graph.landmark_covariances(in_graph),
    )
    objects = confirmed(object_map.to_record(stamp_ns))
    seen = dict[str, set[int]]((name, set()) for name in objects.ids)
    for number in members:
        for name, row in rows_of[number].items():
            seen.get(str(object_map.canonical_id(row)), set()).update(parts[number].seen[name])
    graph_record = observing(graph.to_record(stamp_ns, stamps_ns), objects, np.ones(len(stamps_ns), dtype=np.bool_))
    paths = {
        session: _carried(maps[number], graph_record.T_map_body[place_maps == number], steps)
        for number in members
        for session, steps in parts[number].paths.items()
    }
    metadata = common_metadata(maps[number].metadata for number in members)
    sessions = {name: tuple(sorted(each)) for name, each in seen.items()}
    return Part(SavedMap(objects, graph_record, metadata, ()), paths, sessions, tuple(rejected))


def _carried(saved: SavedMap, T_joint_place: FloatArray, steps: FloatArray) -> FloatArray:
    """Steps (S, 2, 3) m of a path as they move along with the places of its map."""
    return _carry_along(saved, T_joint_place, steps.reshape(-1, 3))[0].reshape(steps.shape)
