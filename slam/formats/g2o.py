"""The graph of a map as g2o text."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import InputDataError
from slam.formats.trajectories import checked_poses, format_numbers, position_and_quaternion, write_lines

TRANSLATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
"""Rows of a pose covariance (rotation first) in g2o's order (translation first)."""


def write_g2o(path: str | Path, graph: FactorGraphRecord, object_map: ObjectMapRecord | None = None) -> None:
    """Write the graph as g2o: keyframes, the edges between them, landmarks and their observations.

    * Keyframes: ``VERTEX_SE3:QUAT id x y z qx qy qz qw``, the first of them fixed by ``FIX``.
    * Edges: ``EDGE_SE3:QUAT from to`` with ``T_from_to`` and the upper triangle of the information matrix, translation
      first. Its rotation part is in 1/rad^2, as GTSAM reads and writes it (g2o itself takes half angles).
    * Landmarks: ``VERTEX_TRACKXYZ`` with ids after the last keyframe's, in the order of their first observation; a
      comment line tells which is which. Observations: ``EDGE_SE3_TRACKXYZ keyframe landmark 0 x y z`` in the body frame
      with their information, through ``PARAMS_SE3OFFSET 0``, the identity.

    Args:
        path: file to write.
        graph: keyframe ids must be non-negative and unique.
        object_map: gives the landmarks' positions; one that it lacks, or all without it, stand at the mean of their
            observations.

    Raises:
        InputDataError: an id is unknown or used twice, a value is not finite, a covariance cannot be inverted.
        UnwritableLogError: the file cannot be written.
    """
    poses = checked_poses(graph.T_map_body, graph.keyframe_ids)
    keyframes = graph.keyframe_ids
    row_of = {keyframe: row for row, keyframe in enumerate(keyframes.tolist())}
    if len(row_of) != len(poses) or min(row_of, default=0) < 0:
        raise InputDataError(f"{len(poses)} keyframes must have unique ids >= 0 to be vertices of a g2o file")
    counts = {
        len(each)
        for each in (graph.observation_keyframe_ids, graph.observation_landmark_ids, graph.observation_positions)
    }
    if len(counts) > 1:
        raise InputDataError("observations of the graph differ in their numbers of keyframes, landmarks and positions")
    if not np.isfinite(graph.observation_positions).all():
        raise InputDataError("an observation of the graph has a position that is not finite; nothing was exported")
    unknown = {*graph.edge_keyframe_ids.ravel().tolist(), *graph.observation_keyframe_ids.tolist()} - row_of.keys()
    if unknown:
        raise InputDataError(f"edges or observations refer to keyframe {min(unknown)}, which the graph does not hold")
    seen_from = poses[[row_of[keyframe] for keyframe in graph.observation_keyframe_ids.tolist()]]
    information = _invert(graph.edge_covariances, "edge")
    steps = checked_poses(graph.edge_transforms, graph.edge_keyframe_ids)
    first_vertex = max(row_of, default=-1) + 1
    lines = [*_landmark_lines(graph, seen_from, object_map, first_vertex)]
    for keyframe, row in zip(keyframes, position_and_quaternion(poses), strict=True):
        lines.append(f"VERTEX_SE3:QUAT {keyframe} {format_numbers(row)}")
    lines += [f"FIX {keyframe}" for keyframe in keyframes[:1]]
    order = TRANSLATION_FIRST
    rows = np.hstack([position_and_quaternion(steps), information[:, order[:, None], order][:, *np.triu_indices(6)]])
    for (start, end), row in zip(graph.edge_keyframe_ids, rows, strict=True):
        lines.append(f"EDGE_SE3:QUAT {start} {end} {format_numbers(row)}")
    write_lines(path, lines)


def _landmark_lines(
    graph: FactorGraphRecord, seen_from: FloatArray, object_map: ObjectMapRecord | None, first_vertex: int
) -> Iterator[str]:
    """Landmarks from ``first_vertex`` on, and their observations from poses (N, 4, 4)."""
    names = tuple(dict.fromkeys(graph.observation_landmark_ids))
    index_of = {name: index for index, name in enumerate(names)}
    indices = np.array([index_of[name] for name in graph.observation_landmark_ids], dtype=np.int64)
    observed = np.einsum("nij,nj->ni", seen_from[:, :3, :3], graph.observation_positions) + seen_from[:, :3, 3]
    positions = np.zeros((len(names), 3))
    np.add.at(positions, indices, observed)
    positions /= np.bincount(indices, minlength=len(names)).reshape(-1, 1)
    if object_map is not None:
        for name, position in zip(object_map.ids, object_map.positions, strict=True):
            if name in index_of:
                positions[index_of[name]] = position
    if names:
        yield "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"
    for vertex, (name, xyz) in enumerate(zip(names, positions, strict=True), start=first_vertex):
        yield f"# landmark {vertex} is {name!a}"
        yield f"VERTEX_TRACKXYZ {vertex} {format_numbers(xyz)}"
    information = _invert(graph.observation_covariances, "observation")[:, *np.triu_indices(3)]
    rows = np.hstack([graph.observation_positions, information])
    for keyframe, index, row in zip(graph.observation_keyframe_ids, indices, rows, strict=True):
        yield f"EDGE_SE3_TRACKXYZ {keyframe} {first_vertex + index} 0 {format_numbers(row)}"


def _invert(covariances: FloatArray, name: str) -> FloatArray:
    try:
        np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError as error:
        raise InputDataError(
            f"an {name} has a covariance that is not positive definite; nothing was exported"
        ) from error
    return np.asarray(np.linalg.inv(covariances))
