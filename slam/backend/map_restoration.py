"""A prior map put into the factor graph: with its factors, or as constants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, Observation
from slam.common.arrays import FloatArray


def restore_factors(
    graph: FactorGraph,
    keyframes: Sequence[int],
    T_map_body: FloatArray,
    edges: Sequence[Edge],
    observations: Sequence[Observation],
    *,
    tie: Edge | None = None,
) -> None:
    """Restore the optimised graph of a prior map, in an empty graph or beside what is there.

    Args:
        graph: takes it in.
        keyframes: ids; without a ``tie`` the first one fixes the map frame.
        T_map_body: (K, 4, 4), their estimates.
        edges: between those keyframes, which they tie all together.
        observations: of landmarks from those keyframes.
        tie: leads from a keyframe that is there to one of these.
    """
    for keyframe, T in zip(keyframes, T_map_body, strict=True):
        if tie is None and keyframe == keyframes[0]:
            graph.add_first_keyframe(keyframe, T)
        else:
            graph.add_keyframe(keyframe, T)
    for edge in edges if tie is None else (tie, *edges):
        graph.add_edge(edge)
    graph.add_observations(observations)
    graph.update()


def add_fixed_map(
    graph: FactorGraph, keyframes: Sequence[int], T_map_body: FloatArray, landmarks: Mapping[int, FloatArray]
) -> None:
    """Add a fixed map, for localization only, to an empty graph.

    Args:
        graph: empty.
        keyframes: ids.
        T_map_body: (K, 4, 4), their poses.
        landmarks: their positions, (3,) m by id; each enters the graph when something is merged into it.
    """
    for keyframe, T in zip(keyframes, T_map_body, strict=True):
        graph.add_fixed_keyframe(keyframe, T)
    graph.add_known_landmarks(landmarks, np.full(3, graph.prior_sigma_m), is_fixed=True)
    graph.update()


def add_map_frame(graph: FactorGraph, keyframe: int) -> None:
    """Add the frame of a map without keyframes to an empty graph: a keyframe at its origin that stays there."""
    graph.add_fixed_keyframe(keyframe, np.eye(4), is_map_frame=True)
    graph.update()
