"""Trajectories and graphs in the text formats of other programs: TUM, KITTI, g2o."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from logs.messages import FactorGraphRecord, ObjectMapRecord, TrajectoryRecord
from logs.storage.placement import write_text
from slam.backend.pose_graph.pose_graph import PoseGraph
from slam.common.arrays import FloatArray
from slam.common.errors import InputDataError
from slam.common.georeference import Georeference
from slam.formats.g2o import format_numbers, graph_lines, position_and_quaternion


def write_tum(path: str | Path, trajectory: TrajectoryRecord) -> None:
    """Write ``stamp x y z qx qy qz qw`` a line: seconds with all nine digits of the nanoseconds, metres, body in map.

    Numbers other than the stamp are the shortest decimals that read back to the same float64.

    Raises:
        InputDataError: stamps and poses differ in number, or a pose is not finite.
        UnwritableLogError: the file cannot be written.
    """
    rows = position_and_quaternion(_checked_poses(trajectory.T_map_body, trajectory.stamps_ns))
    stamps = map(_seconds, trajectory.stamps_ns.tolist())
    _write_lines(path, (f"{stamp} {format_numbers(row)}" for stamp, row in zip(stamps, rows, strict=True)))


def write_geodetic(path: Path, trajectory: TrajectoryRecord, georeference: Georeference) -> None:
    """Write a row a pose: time [s], latitude, longitude [deg] and altitude [m] on WGS 84.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    places = georeference.to_geodetic(trajectory.T_map_body[:, :3, 3]).tolist()
    rows = [
        f"{_seconds(stamp_ns)},{latitude:.9f},{longitude:.9f},{altitude_m:.3f}"
        for stamp_ns, (latitude, longitude, altitude_m) in zip(trajectory.stamps_ns.tolist(), places, strict=True)
    ]
    _write_lines(path, ["stamp_s,latitude_deg,longitude_deg,altitude_m", *rows])


def write_kitti(path: str | Path, trajectory: TrajectoryRecord) -> None:
    """Write the upper 3x4 part of each ``T_map_body``, row by row, a pose a line.

    The poses are those of the **body** (x forward, y left, z up) in the map, one for each odometry message; KITTI's own
    files hold the left camera's (x right, y down, z forward). Errors over stretches of path compare either way,
    provided that both files hold the same frame. The format has no stamps.

    Raises:
        InputDataError: stamps and poses differ in number, or a pose is not finite.
        UnwritableLogError: the file cannot be written.
    """
    poses = _checked_poses(trajectory.T_map_body, trajectory.stamps_ns)
    _write_lines(path, (format_numbers(T[:3].ravel()) for T in poses))


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
    poses = _checked_poses(graph.T_map_body, graph.keyframe_ids)
    keyframes = graph.keyframe_ids
    row_of = {keyframe: row for row, keyframe in enumerate(keyframes.tolist())}
    if len(row_of) != len(poses) or min(row_of, default=0) < 0:
        raise InputDataError(f"{len(poses)} keyframes must have unique ids >= 0 to be vertices of a g2o file")
    counts = {
        len(each)
        for each in (graph.observation_keyframe_ids, graph.observation_landmark_ids, graph.observation_positions)
    }
    if len(counts) > 1:
        raise InputDataError("observations of the graph have keyframes, landmarks and positions of different number")
    if not np.isfinite(graph.observation_positions).all():
        raise InputDataError("an observation of the graph has a position that is not finite; nothing was exported")
    unknown = {*graph.edge_keyframe_ids.ravel().tolist(), *graph.observation_keyframe_ids.tolist()} - row_of.keys()
    if unknown:
        raise InputDataError(f"edges or observations name keyframe {min(unknown)}, which the graph does not hold")
    seen_from = poses[[row_of[keyframe] for keyframe in graph.observation_keyframe_ids.tolist()]]
    pose_graph = PoseGraph(
        vertex_ids=keyframes,
        T_world_vertex=poses,
        edges=graph.edge_keyframe_ids,
        T_from_to=_checked_poses(graph.edge_transforms, graph.edge_keyframe_ids),
        information=_invert(graph.edge_covariances, "edge"),
        fixed_ids=keyframes[:1],
    )
    first_vertex = max(row_of, default=-1) + 1
    _write_lines(path, [*_landmark_lines(graph, seen_from, object_map, first_vertex), *graph_lines(pose_graph)])


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


def _write_lines(path: str | Path, lines: Iterable[str]) -> None:
    write_text(path, "".join(f"{line}\n" for line in lines))


def _checked_poses(poses: FloatArray, names: Sequence[object] | np.ndarray) -> FloatArray:
    poses = poses.reshape(-1, 4, 4)
    if len(poses) != len(names):
        raise InputDataError(f"{len(names)} stamps or ids do not belong to {len(poses)} transforms")
    broken = np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2)))
    if len(broken):
        raise InputDataError(f"transform {broken[0]} of {len(poses)} is not finite; nothing was exported")
    return poses


def _invert(covariances: FloatArray, name: str) -> FloatArray:
    try:
        np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError as error:
        raise InputDataError(
            f"an {name} has a covariance that is not positive definite; nothing was exported"
        ) from error
    return np.asarray(np.linalg.inv(covariances))


def _seconds(stamp_ns: int) -> str:
    whole, rest = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"
