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

from logs.messages import GroundTruthPose, TrajectoryRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import travelled_m
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.metrics.trajectory import compute_relative_errors
from tests.slam.evaluation.drives import KITTI, kitti_poses, needs_kitti
from tests.slam.evaluation.results import at_json

EVO = "evo==1.38.1"
NEXT_POSE_M = 1e-9
"""A stretch of that length reaches from each pose to the next one."""
PARTS = {"rmse_m": "rmse", "mean_m": "mean", "median_m": "median", "max_m": "max"}

pytestmark = [
    needs_kitti,
    pytest.mark.skipif(
        os.environ.get("DSLAM_TEST_EVO") != "1",
        reason="DSLAM_TEST_EVO=1 installs evo into a throw-away environment and compares with it",
    ),
]


@pytest.fixture(scope="module")
def evo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the programs; evo keeps its settings in the home directory, so it gets one of its own."""
    folder = tmp_path_factory.mktemp("evo")
    subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
    pip = [str(folder / "venv" / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, EVO], check=True)
    return folder / "venv" / "bin"


def measure(evo: Path, program: str, *arguments: str | Path) -> dict[str, float]:
    """The statistics that evo computes."""
    home = evo.parents[1]
    result = home / "result.zip"
    result.unlink(missing_ok=True)
    command = [str(evo / program), *map(str, arguments), "--save_results", str(result), "--no_warnings"]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, "HOME": str(home)})
    with zipfile.ZipFile(result) as archive:
        statistics: dict[str, float] = json.loads(archive.read("stats.json"))
    return statistics


def mean_step_errors(T_est: FloatArray, T_gt: FloatArray) -> tuple[float, float]:
    """Means of the errors from each pose to the next: metres and degrees."""
    errors = compute_relative_errors(T_est, T_gt, lengths_m=(NEXT_POSE_M,), start_step=1)
    assert errors.stretch_count == len(T_gt) - 1
    assert errors.translation_percent is not None
    assert errors.rotation_deg_per_100m is not None
    return errors.translation_percent / 100.0 * NEXT_POSE_M, errors.rotation_deg_per_100m / 100.0 * NEXT_POSE_M


def chain(T_gt: FloatArray, length_m: float) -> IntArray:
    """The first pose, and each that ends a stretch of at least ``length_m`` after the one before."""
    path_m = travelled_m(T_gt)
    rows = [0]
    while (row := int(np.searchsorted(path_m, path_m[rows[-1]] + length_m))) < len(path_m):
        rows.append(row)
    return np.array(rows)


def evaluate_ate(stamps_ns: IntArray, T_est: FloatArray, truth_ns: IntArray, T_gt: FloatArray) -> dict[str, float]:
    records = EvaluationRecords(
        trajectory=TrajectoryRecord(0, "map", stamps_ns, T_est),
        true_poses=tuple(GroundTruthPose(int(stamp), T) for stamp, T in zip(truth_ns, T_gt, strict=True)),
    )
    absolute = at_json(evaluate(records), "trajectory.estimate.absolute")
    assert isinstance(absolute, dict)
    return absolute


@pytest.fixture(scope="module")
def sptam() -> FloatArray:
    return kitti_poses("KITTI_00_SPTAM.txt")


@pytest.fixture(scope="module")
def truth() -> FloatArray:
    return kitti_poses("KITTI_00_gt.txt")


@pytest.fixture(scope="module")
def times_s() -> FloatArray:
    return np.loadtxt(KITTI / "KITTI_00_gt_times.txt")


def test_absolute_errors_of_kitti_00(evo: Path, sptam: FloatArray, truth: FloatArray, times_s: FloatArray) -> None:
    files = [KITTI / f"KITTI_00_{name}.txt" for name in ("gt", "SPTAM")]
    theirs = measure(evo, "evo_ape", "kitti", *files, "--align")
    stamps_ns = np.round(times_s * 1e9).astype(np.int64)
    ours = evaluate_ate(stamps_ns, sptam, stamps_ns, truth)
    assert {name: ours[name] for name in PARTS} == pytest.approx({k: theirs[v] for k, v in PARTS.items()}, abs=1e-6)
    assert ours["rmse_m"] == pytest.approx(3.7385, abs=1e-3)


@pytest.mark.parametrize(("unit", "delta"), [("f", 1), ("m", 1), ("m", 10), ("m", 100)])
def test_relative_errors_of_kitti_00(evo: Path, sptam: FloatArray, truth: FloatArray, unit: str, delta: int) -> None:
    """From pose to pose, and over stretches of true path that follow one another."""
    files = [KITTI / f"KITTI_00_{name}.txt" for name in ("gt", "SPTAM")]
    pairs = ["--delta", str(delta), "--delta_unit", unit, "--pairs_from_reference"]
    theirs = [
        measure(evo, "evo_rpe", "kitti", *files, *pairs, "--pose_relation", relation)["mean"]
        for relation in ("trans_part", "angle_deg")
    ]
    rows = np.arange(len(truth)) if unit == "f" else chain(truth, delta)
    assert mean_step_errors(sptam[rows], truth[rows]) == pytest.approx(theirs, abs=1e-6)
