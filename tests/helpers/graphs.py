"""Factor graphs of drives whose truth is known."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from logs.messages import FactorGraphRecord
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind, Observation
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert, relative

PLAIN = 1e6
"""Width of a kernel that gives every factor its full weight."""


def with_edges(graph: FactorGraphRecord, kept: IntArray | slice) -> FactorGraphRecord:
    """The record with those of its edges alone."""
    names = ("edge_keyframe_ids", "edge_transforms", "edge_covariances")
    kinds = tuple(np.array(graph.edge_kinds)[kept].tolist())
    return replace(graph, edge_kinds=kinds, **{name: getattr(graph, name)[kept] for name in names})


def odometry_edges(T: FloatArray, covariance: FloatArray) -> list[Edge]:
    """From each pose (K, 4, 4) to the next, without noise."""
    return [
        Edge(k, k + 1, relative(before, after), covariance, EdgeKind.ODOMETRY)
        for k, (before, after) in enumerate(pairwise(T))
    ]


def observed_from(
    keyframe: int,
    T: FloatArray,
    landmarks: FloatArray,
    rows: Sequence[int] | IntArray,
    covariance: FloatArray,
    errors: FloatArray | float = 0.0,
) -> list[Observation]:
    """What a keyframe at ``T`` (4, 4) observes of ``landmarks`` (L, 3) m: those of ``rows`` (K,)."""
    seen = apply(invert(T), landmarks[rows]) + errors
    return [Observation(keyframe, int(row), at, covariance) for row, at in zip(rows, seen, strict=True)]


def chained(
    T_first: FloatArray, edges: Sequence[Edge], observations: Sequence[Observation] = (), kernel_width: float = PLAIN
) -> FactorGraph:
    """The graph of keyframes that follow one another, not yet updated."""
    graph = FactorGraph(kernel_width=kernel_width)
    graph.add_keyframe(0, T_first)
    for edge in edges:
        graph.add_next_keyframe(edge)
    graph.add_observations(observations)
    return graph
