"""Pose graphs and their g2o files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from slam.backend.pose_graph.pose_graph import PoseGraph
from slam.backend.pose_graph.pose_graph_optimization import optimize_pose_graph
from slam.common.errors import InputDataError
from slam.formats.g2o import read_pose_graph, write_pose_graph
from slam.formats.trajectory_and_graph import write_g2o
from tests.helpers.pose_graphs import with_false
from tests.slam.formats.test_trajectory_and_graph import graph as exported_graph

DATA = Path(gtsam.__file__).parent / "Data"
PLANAR = ("pose2example.txt", "noisyToyGraph.txt")
SPATIAL = ("pose3example.txt", "pose3example-grid.txt", "toyExample.g2o", "Klaus3.g2o", "pose3example-offdiagonal.txt")

INFORMATION_2 = "1 0 0 1 0 1"
INFORMATION_3 = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"


def edge_2(start: int, end: int, x: float = 1.0) -> str:
    return f"EDGE_SE2 {start} {end} {x} 0 0 {INFORMATION_2}"


def edge_3(start: int, end: int, quaternion: str = "0 0 0 1", information: str = INFORMATION_3) -> str:
    return f"EDGE_SE3:QUAT {start} {end} 1 0 0 {quaternion} {information}"


def read(tmp_path: Path, *lines: str) -> PoseGraph:
    path = tmp_path / "in.g2o"
    path.write_text("\n".join(lines) + "\n")
    return read_pose_graph(path).graph


def assert_same(a: PoseGraph, b: PoseGraph, atol: float = 1e-12) -> None:
    np.testing.assert_array_equal(a.vertex_ids, b.vertex_ids)
    np.testing.assert_array_equal(a.edges, b.edges)
    np.testing.assert_array_equal(a.fixed_ids, b.fixed_ids)
    np.testing.assert_allclose(a.T_world_vertex, b.T_world_vertex, atol=atol)
    np.testing.assert_allclose(a.T_from_to, b.T_from_to, atol=atol)
    np.testing.assert_array_equal(a.information, b.information)


# Files


@pytest.mark.parametrize("name", PLANAR + SPATIAL)
def test_a_round_trip(tmp_path: Path, name: str) -> None:
    first = read_pose_graph(DATA / name).graph
    first = replace(first, fixed_ids=first.vertex_ids[1:3])
    write_pose_graph(tmp_path / "a.g2o", first)
    second = read_pose_graph(tmp_path / "a.g2o").graph
    assert_same(first, second)
    write_pose_graph(tmp_path / "b.g2o", second)
    assert_same(second, read_pose_graph(tmp_path / "b.g2o").graph)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.g2o", "b.g2o"]


@pytest.mark.parametrize("name", PLANAR + SPATIAL)
def test_factors_mean_what_gtsam_reads(name: str) -> None:
    """The error at the initial values, and after least squares, is that of GTSAM's own reader."""
    graph = read_pose_graph(DATA / name).graph
    solved = optimize_pose_graph(graph, np.zeros(len(graph.edges), dtype=np.bool_))
    factors, values = gtsam.readG2o(str(DATA / name), not graph.is_planar)
    first = int(graph.vertex_ids.min())
    if graph.is_planar:
        factors.add(gtsam.PriorFactorPose2(first, values.atPose2(first), gtsam.noiseModel.Isotropic.Sigma(3, 1e-5)))
    else:
        factors.add(gtsam.PriorFactorPose3(first, values.atPose3(first), gtsam.noiseModel.Isotropic.Sigma(6, 1e-5)))
    optimizer = gtsam.LevenbergMarquardtOptimizer(factors, values)
    np.testing.assert_allclose(solved.solution.error_before, factors.error(values), rtol=1e-6, atol=1e-9)
    optimizer.optimize()
    np.testing.assert_allclose(solved.solution.error_after, optimizer.error(), rtol=1e-5, atol=1e-6)


def test_a_graph_of_a_map_can_be_read(tmp_path: Path) -> None:
    record = exported_graph()
    write_g2o(tmp_path / "a.g2o", record)
    file = read_pose_graph(tmp_path / "a.g2o")
    np.testing.assert_array_equal(file.graph.vertex_ids, record.keyframe_ids)
    np.testing.assert_allclose(file.graph.T_world_vertex, record.T_map_body, atol=1e-9)
    np.testing.assert_allclose(np.linalg.inv(file.graph.information), record.edge_covariances, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(file.graph.find_closures(), [kind == "closure" for kind in record.edge_kinds])
    assert file.passed_over == {"PARAMS_SE3OFFSET": 1, "VERTEX_TRACKXYZ": 2, "EDGE_SE3_TRACKXYZ": 3}


def test_planar_information_keeps_its_order(tmp_path: Path) -> None:
    graph = read(tmp_path, "EDGE_SE2 0 1 1 2 0.5 11 1 2 22 3 33")
    np.testing.assert_array_equal(graph.information[0], [[11, 1, 2], [1, 22, 3], [2, 3, 33]])


def test_spatial_information_has_the_rotation_first(tmp_path: Path) -> None:
    upper = "11 0 0 1 0 0 12 0 0 2 0 13 0 0 3 21 0 0 22 0 23"
    information = read(tmp_path, edge_3(0, 1, information=upper)).information[0]
    np.testing.assert_array_equal(np.diag(information), [21, 22, 23, 11, 12, 13])
    np.testing.assert_array_equal(information[:3, 3:], np.diag([1, 2, 3]))


def test_comments_blank_lines_and_line_ends(tmp_path: Path) -> None:
    graph = read(tmp_path, "# a comment", "", "  FIX 7\r", edge_2(7, 8) + "\r")
    assert graph.vertex_ids.tolist() == [7, 8]
    assert graph.fixed_ids.tolist() == [7]


def test_a_rounded_quaternion_is_made_unit(tmp_path: Path) -> None:
    T = read(tmp_path, edge_3(0, 1, "0 0 0.7071 0.7073")).T_from_to[0]
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-15)


BAD_LINES = {
    "too few numbers": ("EDGE_SE2 1 2 0 0 0 1 0 0 1 0", "line 2.*10 values"),
    "too many numbers": (edge_2(1, 2) + " 5", "line 2"),
    "no number": ("EDGE_SE2 1 2 one 0 0 1 0 0 1 0 1", "line 2.*one"),
    "nan": ("EDGE_SE2 1 2 nan 0 0 1 0 0 1 0 1", "line 2.*not finite"),
    "infinite information": ("EDGE_SE2 1 2 0 0 0 inf 0 0 1 0 1", "line 2.*not finite"),
    "no id": ("EDGE_SE2 1 2.5 0 0 0 1 0 0 1 0 1", "line 2.*2.5.*not a vertex"),
    "negative id": ("VERTEX_SE2 -1 0 0 0", "line 2.*-1.*not a vertex"),
    "indefinite": ("EDGE_SE2 1 2 0 0 0 1 2 0 1 0 1", "line 2.*not positive definite"),
    "singular": ("EDGE_SE2 1 2 0 0 0 1 0 0 0 0 1", "line 2.*not positive definite"),
    "to itself": (edge_2(1, 1), "line 2.*to itself"),
    "mixed": (edge_3(1, 2), "line 2: spatial poses in a file of planar"),
    "unknown fixed": ("FIX 9", "line 2: FIX of vertex 9, which does not exist"),
}


@pytest.mark.parametrize("bad", BAD_LINES)
def test_a_bad_line_is_refused_by_number(tmp_path: Path, bad: str) -> None:
    line, told = BAD_LINES[bad]
    with pytest.raises(InputDataError, match=f"in.g2o, {told}"):
        read(tmp_path, edge_2(0, 1), line)


@pytest.mark.parametrize("quaternion", ["0 0 0 0", "0 0 0 1.1", "1 1 0 0", "0 0 0.7 0.7"])
def test_a_quaternion_that_is_none_is_refused(tmp_path: Path, quaternion: str) -> None:
    with pytest.raises(InputDataError, match="line 2: the quaternion"):
        read(tmp_path, edge_3(0, 1), edge_3(1, 2, quaternion))


def test_a_vertex_given_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="line 3: vertex 1 is defined twice"):
        read(tmp_path, "VERTEX_SE2 0 0 0 0", "VERTEX_SE2 1 1 0 0", "VERTEX_SE2 1 1 0 0", edge_2(0, 1))


@pytest.mark.parametrize("text", ["", "# nothing\n", "VERTEX_SE2 0 0 0 0\n", "EDGE2 0 1 1 0 0 1 0 0 1 0 1\n"])
def test_a_file_without_edges_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "in.g2o").write_text(text)
    with pytest.raises(InputDataError, match="holds no edge"):
        read_pose_graph(tmp_path / "in.g2o")


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "in.g2o").write_bytes(b"\x89MCAP\xff\xfe")
    with pytest.raises(InputDataError, match="not text"):
        read_pose_graph(tmp_path / "in.g2o")


def test_parts_that_nothing_joins_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"no edges lead from vertex 10, 11 to the other 3"):
        read(tmp_path, edge_2(0, 1), edge_2(1, 2), edge_2(10, 11))
    with pytest.raises(InputDataError, match="from vertex 5 to"):
        read(tmp_path, "VERTEX_SE2 5 0 0 0", edge_2(0, 1))


# Which edges are closures, and where vertices are that have no line


def test_consecutive_edges_are_odometry(tmp_path: Path) -> None:
    edges = [(40, 10), (10, 20), (20, 40), (40, 55), (55, 10), (40, 20)]
    graph = read(tmp_path, *(edge_2(*edge) for edge in edges))
    assert graph.find_closures().tolist() == [True, False, False, False, True, False]


def test_the_first_edge_between_two_drives_is_no_closure(tmp_path: Path) -> None:
    edges = [(0, 1), (1, 2), (100, 101), (101, 102), (2, 101), (0, 101), (1, 102)]
    graph = read(tmp_path, *(edge_2(*edge) for edge in edges))
    assert graph.find_closures().tolist() == [False, False, False, False, False, True, True]


def test_vertices_without_a_line_follow_the_chain(tmp_path: Path) -> None:
    lines = ["VERTEX_SE2 2 7 7 0", edge_2(0, 1), edge_2(2, 1), edge_2(2, 3, 2.0), edge_2(0, 3, 50.0)]
    graph = read(tmp_path, *lines)
    assert graph.vertex_ids.tolist() == [2, 0, 1, 3]
    np.testing.assert_allclose(graph.T_world_vertex[:, :2, 2], [[7, 7], [7, 7], [8, 7], [9, 7]])


def test_without_any_vertex_line_the_first_is_the_origin(tmp_path: Path) -> None:
    graph = read(tmp_path, edge_3(5, 6), edge_3(6, 9))
    np.testing.assert_allclose(graph.T_world_vertex[:, 0, 3], [0, 1, 2])


def test_an_id_that_does_not_exist_is_told_by_its_line(tmp_path: Path) -> None:
    vertices = [f"VERTEX_SE2 {i} {i} 0 0" for i in range(3)]
    with pytest.raises(InputDataError, match=r"line 6: vertex 4000 is not in the graph"):
        read(tmp_path, *vertices, edge_2(0, 1), edge_2(1, 2), edge_2(0, 4000))


# The solution


def test_fixed_vertices_stay_exactly_where_they_are() -> None:
    graph = with_false(10, 10)
    for fixed in (np.array([3, 50]), np.zeros(0, dtype=np.int64)):
        held = replace(graph, fixed_ids=fixed)
        solved = optimize_pose_graph(held, held.find_closures()).graph
        rows = fixed if len(fixed) else np.array([0])
        np.testing.assert_array_equal(solved.T_world_vertex[rows], graph.T_world_vertex[rows])
        assert np.abs(solved.T_world_vertex[100] - graph.T_world_vertex[100]).max() > 0.01
