"""Errors drawn from known covariances, and from others than the map says."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from logs.messages import FactorGraphRecord, GroundTruthPose
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert, pose_errors
from slam.evaluation.metrics.calibration import NEEDS, measure_consistency
from tests.helpers.poses import pose_at
from tests.slam.evaluation.drives import stamps, winding_path
from tests.slam.evaluation.loops import closure
from tests.slam.evaluation.maps import frames, object_map
from tests.slam.evaluation.results import Log, associated, graph, measured, with_field, without

COUNT = 3000
T_WORLD_MAP = pose_at(20.0, 30.0, z=1.0, yaw=2.4)
ANISOTROPIC = np.diag([0.002, 0.003, 0.01, 0.5, 0.05, 0.1]) ** 2
"""Sure of the left and the right, unsure of the way ahead."""


def random_covariances(rng: np.random.Generator, count: int, size: int) -> FloatArray:
    factors = rng.normal(size=(count, size, size)) * rng.uniform(0.01, 0.1, size=(count, size, 1))
    return np.asarray(factors @ np.swapaxes(factors, 1, 2) + 1e-5 * np.eye(size))


def draw(rng: np.random.Generator, covariances: FloatArray) -> FloatArray:
    normals = rng.normal(size=covariances.shape[:2])
    return np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), normals)


def exponential(xi: FloatArray) -> FloatArray:
    return np.array([gtsam.Pose3.Expmap(each).matrix() for each in xi]).reshape(-1, 4, 4)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_nees_detects_too_small_and_too_large_covariances(factor: float) -> None:
    rng = np.random.default_rng(1)
    covariances = random_covariances(rng, COUNT, 6)
    result = measure_consistency(draw(rng, covariances), factor * covariances)
    assert result["nees"] == pytest.approx(1.0 / factor, rel=0.05)


def test_unusable_covariances_are_left_out() -> None:
    covariances = np.stack([np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan), -np.eye(3)])
    result = measure_consistency(np.ones((4, 3)), covariances)
    assert (result["count"], result["nees"]) == (1, pytest.approx(1.0))
    for count in (0, 2):
        nothing = measure_consistency(np.ones((count, 3)), np.zeros((count, 3, 3)))
        assert nothing == {"nees": None, "count": 0}


@pytest.mark.parametrize("size", [0.0, 1e-5, 3.0])
def test_pose_errors_are_right_perturbations(size: float) -> None:
    rng = np.random.default_rng(3)
    xi = rng.normal(size=(50, 6))
    xi[:, :3] *= size / np.linalg.norm(xi[:, :3], axis=1)[:, None]
    T_est = exponential(rng.normal(size=(50, 6)))
    np.testing.assert_allclose(pose_errors(T_est, T_est @ exponential(xi)), xi, rtol=1e-7, atol=1e-9)


def log_of_a_drive(*, poses: int = 400, landmarks: int = 400) -> Log:
    """Poses, landmarks and closures whose errors have the covariances that the log tells.

    The drive heads to all sides, in a map turned by 2.4 rad against the world.
    """
    rng = np.random.default_rng(0)
    at, T_gt = stamps(poses), winding_path(poses)
    T_map_gt = invert(T_WORLD_MAP) @ T_gt
    covariances = np.tile(ANISOTROPIC, (poses, 1, 1))
    error = exponential(draw(rng, covariances))
    error[0] = np.eye(4)
    T_map_body = T_map_gt @ invert(error)
    log: Log = [("/ground_truth", GroundTruthPose(t, T)) for t, T in zip(at.tolist(), T_gt, strict=True)]
    log.append(("/slam/graph", replace(graph(at, T_map_body), pose_covariances=covariances)))
    ids = tuple(str(index) for index in range(landmarks))
    true_ids = tuple(f"o{index}" for index in range(landmarks))
    positions = rng.uniform(-100.0, 100.0, (landmarks, 3))
    spread = random_covariances(rng, landmarks, 3)
    in_map = apply(invert(T_WORLD_MAP), positions) + draw(rng, spread)
    labels = ("tree",) * landmarks
    log.append(("/ground_truth/objects", object_map(true_ids, positions, labels)))
    log.append(("/slam/map", replace(object_map(ids, in_map, labels), covariances=spread)))
    sightings = [(truth, name, True) for truth, name in zip(true_ids, ids, strict=True)]
    log += associated(frames(sightings, stamps_ns=[int(at[0])]))
    of_closures = 0.01 * random_covariances(rng, poses // 2, 6)  # small, so that all of them count as true
    off = exponential(draw(rng, of_closures))
    for row in range(poses // 2):
        T_reference_query = invert(T_gt[row]) @ T_gt[-1 - row] @ invert(off[row])
        made = closure(poses - 1 - row, row)
        stamps_ns = {"stamp_ns": int(at[-1 - row]), "reference_stamp_ns": int(at[row])}
        made = replace(made, **stamps_ns, T_reference_query=T_reference_query, covariance=of_closures[row])
        log.append(("/slam/closures", made))
    return log


def test_nees_of_right_covariances_is_1_in_every_part() -> None:
    quality = measured(log_of_a_drive()).to_json_dict()["calibration"]
    for name in NEEDS:
        assert quality[f"{name}_nees"] == pytest.approx(1.0, abs=0.2), name
    assert quality["pose_count"] == 399  # the first keyframe is where the truth is tied


def test_landmarks_are_tied_at_first_keyframe() -> None:
    turned = with_field(log_of_a_drive(), FactorGraphRecord, "T_map_body", lambda T: pose_at(yaw=0.1) @ T)
    quality = measured(turned).to_json_dict()["calibration"]
    assert quality["pose_nees"] == pytest.approx(1.0, abs=0.2)
    assert quality["landmark_nees"] > 100.0


SHORT = log_of_a_drive(poses=40, landmarks=40)


@pytest.mark.parametrize(
    ("log", "left", "reason"),
    [
        (without(SHORT, "/slam/closures"), {"pose": 39, "landmark": 40}, "closures: "),
        (without(SHORT, "/ground_truth/detections"), {"pose": 39, "closure": 20}, "landmarks: "),
        (without(SHORT, "/slam/graph"), {"closure": 20}, "keyframes: "),
        (
            with_field(SHORT, FactorGraphRecord, "pose_covariances", lambda covariances: covariances[:0]),
            {"landmark": 40, "closure": 20},
            "keyframes: ",
        ),
        (SHORT[1:], {"closure": 19}, "first keyframe"),
        (without(SHORT, "/ground_truth"), {}, "--reference"),
    ],
)
def test_calibration_names_missing_parts(log: Log, left: dict[str, int], reason: str) -> None:
    result = measured(log)
    assert reason in result.unavailable["calibration"]
    quality = result.to_json_dict()["calibration"]
    counts = {name: quality[f"{name}_count"] for name in NEEDS}
    assert {name: count for name, count in counts.items() if count} == left
    for name in NEEDS.keys() - left.keys():
        assert quality[f"{name}_nees"] is None
