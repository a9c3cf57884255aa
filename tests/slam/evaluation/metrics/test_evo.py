"""Trajectory errors against evo (https://github.com/MichaelGrupp/evo, GPL-3), run as a program of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import travelled_m
from slam.evaluation.metrics.trajectory import compute_relative_error, evaluate_trajectory
from tests.helpers.data import KITTI, needs_kitti
from tests.slam.evaluation.drives import kitti_poses, series

PROGRAMS = Path(sys.executable).parent
FILES = [str(KITTI / f"KITTI_00_{name}.txt") for name in ("gt", "SPTAM")]
NEXT_POSE_M = 1e-9
"""A stretch of that length reaches from each pose to the next one."""

pytestmark = [
    needs_kitti,
    pytest.mark.slow,
    pytest.mark.skipif(not (PROGRAMS / "evo_ape").exists(), reason="evo is not installed: pip install '.[dev]'"),
]


def measure(program: str, *options: str, home: Path) -> dict[str, float]:
    """The statistics that evo computes for KITTI 00; it keeps its settings in the home directory."""
    result = home / "result.zip"
    result.unlink(missing_ok=True)
    command = [str(PROGRAMS / program), "kitti", *FILES, *options, "--save_results", str(result), "--no_warnings"]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, "HOME": str(home)})
    with zipfile.ZipFile(result) as archive:
        statistics: dict[str, float] = json.loads(archive.read("stats.json"))
    return statistics


def chain(T_gt: FloatArray, length_m: float) -> IntArray:
    """The first pose, and each that ends a stretch of at least ``length_m`` after the one before."""
    path_m = travelled_m(T_gt)
    rows = [0]
    while (row := int(np.searchsorted(path_m, path_m[rows[-1]] + length_m))) < len(path_m):
        rows.append(row)
    return np.array(rows)


@pytest.fixture(scope="module")
def poses() -> tuple[FloatArray, FloatArray]:
    """Truth and estimate of KITTI 00."""
    return kitti_poses("KITTI_00_gt.txt"), kitti_poses("KITTI_00_SPTAM.txt")


def test_absolute_errors_agree_with_evo(poses: tuple[FloatArray, FloatArray], tmp_path: Path) -> None:
    theirs = measure("evo_ape", "--align", home=tmp_path)
    truth, estimate = poses
    ours = evaluate_trajectory(series(estimate), series(truth), max_gap_s=1.0)
    found = (ours.ate_m, ours.median_m, ours.max_m)
    assert found == pytest.approx([theirs[name] for name in ("rmse", "median", "max")], abs=1e-6)
    assert ours.ate_m == pytest.approx(3.7385, abs=1e-3)


@pytest.mark.parametrize(("unit", "delta"), [("f", 1), ("m", 100)])
def test_relative_errors_agree_with_evo(
    poses: tuple[FloatArray, FloatArray], tmp_path: Path, unit: str, delta: int
) -> None:
    """From pose to pose, and over stretches of true path that follow one another."""
    pairs = ["--delta", str(delta), "--delta_unit", unit, "--pairs_from_reference"]
    theirs = [
        measure("evo_rpe", *pairs, "--pose_relation", relation, home=tmp_path)["mean"]
        for relation in ("trans_part", "angle_deg")
    ]
    truth, estimate = poses
    rows = np.arange(len(truth)) if unit == "f" else chain(truth, delta)
    errors = compute_relative_error(estimate[rows], truth[rows], lengths_m=(NEXT_POSE_M,), start_step=1)
    ours = [error / 100.0 * NEXT_POSE_M for error in errors]
    assert ours == pytest.approx(theirs, abs=1e-6)
