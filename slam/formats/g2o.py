"""The graph of a map as g2o text."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import InputDataError
from slam.formats.trajectories import format_numbers, position_and_quaternion, write_lines
from slam.object_map.map_validation import find_graph_fault


def write_g2o(path: str | Path, graph: FactorGraphRecord, object_map: ObjectMapRecord) -> None:
    """Write the graph as g2o: keyframes, the edges between them, landmarks and their observations.

    * Keyframes: ``VERTEX_SE3:QUAT id x y z qx qy qz qw``, the first of them fixed by ``FIX``.
    * Edges: ``EDGE_SE3:QUAT from to`` with ``T_from_to`` and the upper triangle of the information matrix, translation
      first. Its rotation part is in 1/rad^2, as GTSAM reads and writes it (g2o itself takes half angles).
    * Landmarks: ``VERTEX_TRACKXYZ`` with ids after the last keyframe's, in the order of their first observation; a
      comment line tells which is which. Observations: ``EDGE_SE3_TRACKXYZ keyframe landmark 0 x y z`` in the body frame
      with their information, through ``PARAMS_SE3OFFSET 0``, the identity.

    Raises:
        InputDataError: an id is unknown or used twice, or a covariance is not positive definite.
        UnwritableLogError: the file cannot be written.
    """
    if fault := find_graph_fault(object_map, graph):
        raise InputDataError(f"nothing was exported: {fault}")
    keyframes, places = graph.keyframe_ids, dict(zip(object_map.ids, object_map.positions, strict=True))
    lines = [*_landmark_lines(graph, places, max(keyframes.tolist(), default=-1) + 1)]
    for keyframe, row in zip(keyframes, position_and_quaternion(graph.T_map_body), strict=True):
        lines.append(f"VERTEX_SE3:QUAT {keyframe} {format_numbers(row)}")
    lines += [f"FIX {keyframe}" for keyframe in keyframes[:1]]
    order = np.array([3, 4, 5, 0, 1, 2])  # ours is rotation first
    information = np.linalg.inv(graph.edge_covariances)[:, order[:, None], order][:, *np.triu_indices(6)]
    rows = np.hstack([position_and_quaternion(graph.edge_transforms), information])
    for (start, end), row in zip(graph.edge_keyframe_ids, rows, strict=True):
        lines.append(f"EDGE_SE3:QUAT {start} {end} {format_numbers(row)}")
    write_lines(path, lines)


def _landmark_lines(graph: FactorGraphRecord, places: Mapping[str, FloatArray], first_vertex: int) -> Iterator[str]:
    """Landmarks from ``first_vertex`` on, and their observations."""
    vertex_of = {
        name: vertex for vertex, name in enumerate(dict.fromkeys(graph.observation_landmark_ids), first_vertex)
    }
    if vertex_of:
        yield "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"
    for name, vertex in vertex_of.items():
        yield f"# landmark {vertex} is {name!a}"
        yield f"VERTEX_TRACKXYZ {vertex} {format_numbers(places[name])}"
    information = np.linalg.inv(graph.observation_covariances)[:, *np.triu_indices(3)]
    rows = np.hstack([graph.observation_positions, information])
    for keyframe, name, row in zip(graph.observation_keyframe_ids, graph.observation_landmark_ids, rows, strict=True):
        yield f"EDGE_SE3_TRACKXYZ {keyframe} {vertex_of[name]} 0 {format_numbers(row)}"
