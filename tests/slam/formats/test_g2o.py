from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.common.errors import InputDataError
from slam.evaluation.inputs.records import read_records
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.formats.g2o import write_g2o
from slam.formats.trajectories import write_kitti, write_tum

Result = tuple[PoseSeries, FactorGraphRecord, ObjectMapRecord]


@pytest.fixture(scope="module")
def result(noisy_output: Path) -> Result:
    """Of a drive around the block."""
    records = read_records(noisy_output)
    assert records.graph is not None
    assert records.object_map is not None
    return records.final_path, records.graph, records.object_map


def test_tum_comes_back_exactly(result: Result, tmp_path: Path) -> None:
    trajectory, _, _ = result
    write_tum(tmp_path / "a.tum", trajectory.stamps_ns, trajectory.T_world_body)
    lines = [line.split(" ") for line in (tmp_path / "a.tum").read_text().splitlines()]
    assert [line[0] for line in lines] == [f"{ns // 10**9}.{ns % 10**9:09d}" for ns in trajectory.stamps_ns.tolist()]
    numbers = np.array([line[1:] for line in lines], float)
    np.testing.assert_array_equal(numbers[:, :3], trajectory.T_world_body[:, :3, 3])
    R = Rotation.from_quat(numbers[:, 3:]).as_matrix()
    # Products of rotations are orthonormal to rounding only; a quaternion holds the nearest rotation.
    nearest = Rotation.from_matrix(trajectory.T_world_body[:, :3, :3]).as_matrix()
    np.testing.assert_allclose(R, nearest, rtol=0.0, atol=1e-14)


def test_kitti_comes_back_exactly(result: Result, tmp_path: Path) -> None:
    trajectory, _, _ = result
    write_kitti(tmp_path / "a.txt", trajectory.T_world_body)
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "a.txt").reshape(-1, 3, 4), trajectory.T_world_body[:, :3])


def test_gtsam_reads_the_same_graph_from_g2o(result: Result, tmp_path: Path) -> None:
    _, graph, object_map = result
    write_g2o(tmp_path / "a.g2o", graph, object_map)
    factors, values = gtsam.readG2o(str(tmp_path / "a.g2o"), True)
    for keyframe, T in zip(graph.keyframe_ids.tolist(), graph.T_map_body, strict=True):
        np.testing.assert_allclose(values.atPose3(keyframe).matrix(), T, atol=1e-9)
    between = [factors.at(i) for i in range(factors.size()) if isinstance(factors.at(i), gtsam.BetweenFactorPose3)]
    for factor, ids, T, covariance in zip(
        between, graph.edge_keyframe_ids.tolist(), graph.edge_transforms, graph.edge_covariances, strict=True
    ):
        assert list(factor.keys()) == ids
        np.testing.assert_allclose(factor.measured().matrix(), T, atol=1e-9)  # type: ignore[attr-defined]
        np.testing.assert_allclose(factor.noiseModel().covariance(), covariance, rtol=1e-6, atol=1e-12)  # type: ignore[attr-defined]


def test_g2o_of_landmarks(result: Result, tmp_path: Path) -> None:
    _, graph, object_map = result
    write_g2o(tmp_path / "a.g2o", graph, object_map)
    lines = [line.split(" ") for line in (tmp_path / "a.g2o").read_text().splitlines()]
    vertices = {line[1]: np.array(line[2:], float) for line in lines if line[0] == "VERTEX_TRACKXYZ"}
    assert min(map(int, vertices)) == graph.keyframe_ids.max() + 1
    assert len(vertices) == len(set(graph.observation_landmark_ids))
    edges = [line for line in lines if line[0] == "EDGE_SE3_TRACKXYZ"]
    for edge, keyframe, name, position, covariance in zip(
        edges, graph.observation_keyframe_ids, graph.observation_landmark_ids, graph.observation_positions,
        graph.observation_covariances, strict=True
    ):  # fmt: skip
        assert (edge[1], edge[3]) == (str(keyframe), "0")
        np.testing.assert_array_equal(vertices[edge[2]], object_map.positions[object_map.ids.index(name)])
        expected = [*position, *np.linalg.inv(covariance)[np.triu_indices(3)]]
        np.testing.assert_allclose(np.array(edge[4:], float), expected, rtol=1e-6)
    assert ["PARAMS_SE3OFFSET", "0", "0", "0", "0", "0", "0", "0", "1"] in lines
    assert ["FIX", "0"] in lines


def test_write_g2o_refuses_invalid_graph(result: Result, tmp_path: Path) -> None:
    _, graph, object_map = result
    wrong = replace(graph, edge_keyframe_ids=np.full_like(graph.edge_keyframe_ids, 9999))
    with pytest.raises(InputDataError, match=r"nothing was exported: .* keyframe 9999"):
        write_g2o(tmp_path / "a.g2o", wrong, object_map)
    assert list(tmp_path.iterdir()) == []
