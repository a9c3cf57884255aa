"""A prior map as segment 0 of the odometry: relocalization in it is a closure across a discontinuity."""

from __future__ import annotations

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind, Observation
from slam.object_map.landmarks import ObjectMap
from slam.object_map.map_io import SavedMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose

TRAVEL_M = -1e9
"""Travel of everything in the prior map. An optimised map has no traversals: all of it is consistent.
Longer ago than any drive is long."""
SEGMENT = 0
STAMP_NS = -1
"""The clocks of the drives are unrelated."""


def restore(saved: SavedMap, object_map: ObjectMap, graph: FactorGraph, *, fixed: bool) -> list[Keyframe]:
    """Put a prior map into an empty object map and an empty graph; returns its keyframes, renumbered from 0.

    Args:
        saved: the map.
        object_map: empty.
        graph: empty.
        fixed: keep the map as it is: its keyframes and landmarks are constants, and its factors are not restored.
    """
    rows = object_map.restore(saved.objects, travel_m=TRAVEL_M)
    keyframes = [
        Keyframe(number, OdometryPose(STAMP_NS, T_map_body, TRAVEL_M, SEGMENT, np.inf), T_map_body, is_prior=True)
        for number, T_map_body in enumerate(saved.graph.T_map_body)
    ]
    if fixed:
        positions = dict(zip(rows.tolist(), saved.objects.positions, strict=True))
        graph.add_fixed_map(range(len(keyframes)), saved.graph.T_map_body, positions)
        return keyframes
    row_of = dict(zip(saved.objects.ids, rows.tolist(), strict=True))
    record = saved.graph
    number_of = {int(keyframe): number for number, keyframe in enumerate(record.keyframe_ids)}
    graph.restore(
        list(number_of.values()),
        record.T_map_body,
        dict(zip(rows.tolist(), saved.objects.positions, strict=True)),
        [
            Edge(number_of[int(first)], number_of[int(second)], T_from_to, covariance, EdgeKind(kind))
            for (first, second), T_from_to, covariance, kind in zip(
                record.edge_keyframe_ids,
                record.edge_transforms,
                record.edge_covariances,
                record.edge_kinds,
                strict=True,
            )
        ],
        [
            Observation(
                number_of[int(keyframe)],
                row_of[landmark],
                position,
                covariance / covariance_inflation,
                covariance_inflation,
            )
            for keyframe, landmark, position, covariance, covariance_inflation in zip(
                record.observation_keyframe_ids,
                record.observation_landmark_ids,
                record.observation_positions,
                record.observation_covariances,
                record.observation_redundancies.tolist() or [1.0] * len(record.observation_landmark_ids),
                strict=True,
            )
        ],
    )
    return keyframes
