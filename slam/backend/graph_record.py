"""Conversion of the factor graph to a record of a log and back."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from logs.messages import FactorGraphRecord
from slam.backend.factors import Edge, EdgeKind, Observation, stacked
from slam.common.arrays import FloatArray, IntArray


def make_graph_record(
    stamp_ns: int,
    keyframes: IntArray,
    keyframe_stamps_ns: IntArray,
    T_map_body: FloatArray,
    edges: Sequence[Edge],
    observations: Sequence[Observation],
    name_of: Callable[[int], int | str],
) -> FactorGraphRecord:
    """The record of a graph, without its priors and the covariances of its poses.

    Args:
        stamp_ns: of the record.
        keyframes: (K,) ids.
        keyframe_stamps_ns: (K,).
        T_map_body: (K, 4, 4), their estimates.
        edges: all that are in force.
        observations: likewise.
        name_of: the id of a landmark in the record: that of the landmark that it was merged into.
    """
    observers, landmarks, positions, covariances, inflations = stacked(observations)
    return FactorGraphRecord(
        stamp_ns=stamp_ns,
        keyframe_ids=keyframes,
        keyframe_stamps_ns=keyframe_stamps_ns,
        T_map_body=T_map_body,
        edge_keyframe_ids=np.array([(e.from_keyframe, e.to_keyframe) for e in edges], dtype=np.int64).reshape(-1, 2),
        edge_transforms=np.array([e.T_from_to for e in edges]).reshape(-1, 4, 4),
        edge_covariances=np.array([e.covariance for e in edges]).reshape(-1, 6, 6),
        edge_kinds=tuple(str(e.kind) for e in edges),
        observation_keyframe_ids=observers,
        observation_landmark_ids=tuple(str(name_of(landmark)) for landmark in landmarks.tolist()),
        observation_positions=positions,
        observation_covariances=inflations[:, None, None] * covariances,
        observation_redundancies=inflations if (inflations != 1.0).any() else np.zeros(0),
    )


def edges_of(record: FactorGraphRecord, keyframe_of: Mapping[int, int]) -> list[Edge]:
    """The edges of a record; ``keyframe_of``: the numbers of its keyframes in the graph that they go into."""
    return [
        Edge(keyframe_of[first], keyframe_of[second], T_from_to, covariance, EdgeKind(kind))
        for (first, second), T_from_to, covariance, kind in zip(
            record.edge_keyframe_ids.tolist(),
            record.edge_transforms,
            record.edge_covariances,
            record.edge_kinds,
            strict=True,
        )
    ]


def observations_of(
    record: FactorGraphRecord, keyframe_of: Mapping[int, int], landmark_of: Mapping[str, int]
) -> list[Observation]:
    """The observations of a record, with the numbers of its keyframes and landmarks in the graph they go into."""
    count = len(record.observation_landmark_ids)
    return [
        Observation(keyframe_of[keyframe], landmark_of[landmark], position, covariance / inflation, inflation)
        for keyframe, landmark, position, covariance, inflation in zip(
            record.observation_keyframe_ids.tolist(),
            record.observation_landmark_ids,
            record.observation_positions,
            record.observation_covariances,
            record.observation_redundancies.tolist() or [1.0] * count,
            strict=True,
        )
    ]
