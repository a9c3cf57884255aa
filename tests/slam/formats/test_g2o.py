from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.messages import FactorGraphRecord, TrajectoryRecord
from slam.common.arrays import FloatArray
from slam.common.errors import InputDataError
from slam.common.geometry import make_transform
from slam.formats.g2o import write_g2o
from slam.formats.trajectories import write_kitti, write_tum
from tests.slam.evaluation.maps import object_map


def random_poses(count: int, rng: np.random.Generator) -> FloatArray:
    return make_transform(Rotation.random(count, rng=rng).as_matrix(), rng.normal(size=(count, 3)) * 100.0)


def random_covariances(count: int, size: int, rng: np.random.Generator) -> FloatArray:
    A = rng.normal(size=(count, size, size))
    return A @ A.transpose(0, 2, 1) + 0.1 * np.eye(size)


def trajectory(count: int) -> TrajectoryRecord:
    rng = np.random.default_rng(2)
    stamps_ns = 5 + np.cumsum(rng.integers(1, 10**9, count))
    return TrajectoryRecord(0, "map", stamps_ns, random_poses(count, rng) if count else np.zeros((0, 4, 4)))


def graph() -> FactorGraphRecord:
    rng = np.random.default_rng(4)
    ids = np.array([0, 3, 7, 12], dtype=np.int64)
    poses = random_poses(4, rng)
    edges = np.array([[0, 3], [3, 7], [7, 12], [12, 0]], dtype=np.int64)
    seen_from = np.array([0, 3, 7], dtype=np.int64)
    return FactorGraphRecord(
        stamp_ns=0,
        keyframe_ids=ids,
        keyframe_stamps_ns=ids * 10**9,
        T_map_body=poses,
        edge_keyframe_ids=edges,
        edge_transforms=random_poses(4, rng),
        edge_covariances=random_covariances(4, 6, rng),
        edge_kinds=("odometry",) * 3 + ("closure",),
        observation_keyframe_ids=seen_from,
        observation_landmark_ids=("b", "a", "b"),
        observation_positions=rng.normal(size=(3, 3)),
        observation_covariances=random_covariances(3, 3, rng),
    )


LANDMARKS = object_map(("a", "b"), np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), ("tree", "pole"))


@pytest.mark.parametrize("count", [0, 50])
def test_tum_comes_back_exactly(tmp_path: Path, count: int) -> None:
    record = trajectory(count)
    path = tmp_path / "a.tum"
    write_tum(path, record)
    lines = [line.split(" ") for line in path.read_text().splitlines()]
    assert [line[0] for line in lines] == [f"{ns // 10**9}.{ns % 10**9:09d}" for ns in record.stamps_ns.tolist()]
    numbers = np.array([line[1:] for line in lines], dtype=np.float64).reshape(-1, 7)
    np.testing.assert_array_equal(numbers[:, :3], record.T_map_body[:, :3, 3])
    if count:
        R = Rotation.from_quat(numbers[:, 3:]).as_matrix()
        np.testing.assert_allclose(R, record.T_map_body[:, :3, :3], atol=1e-14)
    assert [p.name for p in tmp_path.iterdir()] == ["a.tum"]


def test_kitti_comes_back_exactly(tmp_path: Path) -> None:
    record = trajectory(5)
    write_kitti(tmp_path / "a.txt", record)
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "a.txt").reshape(-1, 3, 4), record.T_map_body[:, :3])


def test_gtsam_reads_the_same_graph_from_g2o(tmp_path: Path) -> None:
    record = graph()
    write_g2o(tmp_path / "a.g2o", record, LANDMARKS)
    factors, values = gtsam.readG2o(str(tmp_path / "a.g2o"), True)
    for keyframe, T in zip(record.keyframe_ids.tolist(), record.T_map_body, strict=True):
        np.testing.assert_allclose(values.atPose3(keyframe).matrix(), T, atol=1e-12)
    between = [factors.at(i) for i in range(factors.size()) if isinstance(factors.at(i), gtsam.BetweenFactorPose3)]
    assert len(between) == 4
    for factor, ids, T, covariance in zip(
        between, record.edge_keyframe_ids.tolist(), record.edge_transforms, record.edge_covariances, strict=True
    ):
        assert list(factor.keys()) == ids
        np.testing.assert_allclose(factor.measured().matrix(), T, atol=1e-12)  # type: ignore[attr-defined]
        np.testing.assert_allclose(factor.noiseModel().covariance(), covariance, rtol=1e-8, atol=1e-10)  # type: ignore[attr-defined]


def test_g2o_of_landmarks_by_hand(tmp_path: Path) -> None:
    record = graph()
    write_g2o(tmp_path / "a.g2o", record, LANDMARKS)
    lines = [line.split(" ") for line in (tmp_path / "a.g2o").read_text().splitlines()]
    vertices = {line[1]: np.array(line[2:], dtype=float) for line in lines if line[0] == "VERTEX_TRACKXYZ"}
    np.testing.assert_array_equal([vertices["14"], vertices["13"]], LANDMARKS.positions)
    edges = [line for line in lines if line[0] == "EDGE_SE3_TRACKXYZ"]
    assert [line[1:4] for line in edges] == [["0", "13", "0"], ["3", "14", "0"], ["7", "13", "0"]]
    information = np.linalg.inv(record.observation_covariances[1])
    expected = [*record.observation_positions[1], *information[np.triu_indices(3)]]
    np.testing.assert_allclose(np.array(edges[1][4:], dtype=float), expected, rtol=1e-9)
    assert ["PARAMS_SE3OFFSET", "0", "0", "0", "0", "0", "0", "0", "1"] in lines
    assert ["FIX", "0"] in lines


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"edge_covariances": np.zeros((4, 6, 6))}, "positive definite"),
        ({"edge_keyframe_ids": np.array([[0, 3], [3, 7], [7, 99], [12, 0]])}, "99"),
        ({"keyframe_ids": np.array([0, 3, 7, 7])}, "unique"),
        ({"observation_landmark_ids": ("a", "c", "b")}, "'c', which the map does not hold"),
    ],
)
def test_write_g2o_refuses_invalid_graph(tmp_path: Path, fields: dict[str, object], message: str) -> None:
    with pytest.raises(InputDataError, match=message):
        write_g2o(tmp_path / "a.g2o", replace(graph(), **fields), LANDMARKS)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
