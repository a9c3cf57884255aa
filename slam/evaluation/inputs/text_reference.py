"""True poses in a text file: TUM, KITTI or CSV, also packed by gzip."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.importers.text_files import read_source_text
from logs.importers.trajectory_files import TrajectoryFormat, read_trajectory
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries, synchronize


def read_text_reference(file: Path, calib: Path | None, path: PoseSeries) -> PoseSeries:
    """The true poses of the body.

    Args:
        file: the poses.
        calib: of poses in KITTI's format, if they are of the left camera.
        path: the odometry, or an estimate. Poses in KITTI's format, as many as these, are at its stamps.

    Raises:
        DatasetError: a file is missing or wrong, or has another number of poses without stamps.
        EvaluationError: the axes of the poses are not those of the body.
    """
    source = read_source_text(file)
    calibration = None if calib is None else read_source_text(calib)
    trajectory = read_trajectory(source, times_ns=path.stamps_ns, calib=calibration)
    is_camera = trajectory.format == TrajectoryFormat.KITTI and calib is None
    remedy = "give --calib, as KITTI's are of the left camera" if is_camera else "give poses of the body"
    truth = PoseSeries(trajectory.stamps_ns, trajectory.T_world_body)
    _check_axes(source.name, truth, path, remedy)
    return truth


def _check_axes(name: str, truth: PoseSeries, path: PoseSeries, remedy: str) -> None:
    """The robot moves in the same direction of its body by both, on stretches of equal length."""
    try:
        est, gt = synchronize(path, truth, max_gap_s=Protocol().max_truth_gap_s)
    except EvaluationError:
        return  # The comparison reports that they do not overlap.
    rows = np.unique(np.searchsorted(gt.travelled_m, np.linspace(0.0, gt.travelled_m[-1], 201)))
    ways = []
    for T in (est.T_world_body[rows], gt.T_world_body[rows]):
        ways.append(np.einsum("nji,nj->ni", T[:-1, :3, :3], np.diff(T[:, :3, 3], axis=0)))
    moved_m = np.linalg.norm(ways, axis=2)  # (2, stretches)
    lengths = moved_m[0] * moved_m[1]
    moved = lengths > 0.0
    if not moved.any():
        return
    cosines = np.sum(ways[0] * ways[1], axis=1)[moved] / lengths[moved]
    turned_deg = float(np.rad2deg(np.median(np.arccos(np.clip(cosines, -1.0, 1.0)))))
    # Half of what x, y and z are apart.
    if turned_deg > 45.0:
        raise EvaluationError(
            f"{name}: the direction of travel differs from that of the odometry by {turned_deg:.0f} deg "
            f"(median), so the axes of these poses are not those of the body; {remedy}"
        )
