"""dslam optimize, and dslam benchmark closures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import FactorGraphRecord, GroundTruthPose
from logs.writer import LogWriter
from slam.backend.pose_graph.pose_graph import PoseGraph
from slam.common.geometry import transform_from_xyz_yaw
from slam.formats.g2o import read_pose_graph, write_pose_graph
from tests.helpers.pose_graphs import VERTICES, rmse_m, true_poses, with_false
from tests.tools.runs import Run, assert_refused

TRUE, FALSE = 16, 24
LINE = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "in.g2o"
    write_pose_graph(path, with_false(TRUE, FALSE))
    return path


@pytest.mark.parametrize("command", ["optimize", "benchmark closures"])
def test_the_help_has_an_example(dslam: Run, command: str) -> None:
    assert f"Example: dslam {command}" in " ".join(dslam(*command.split(), "--help").out.split())


class TestOptimize:
    def test_iterations_are_a_number_that_the_solver_can_hold(self, dslam: Run, source: Path, tmp_path: Path) -> None:
        result = dslam("optimize", source, "-o", tmp_path / "out.g2o", "--max-iterations", 10**12)
        assert_refused(result, "--max-iterations")

    @pytest.mark.parametrize("folder", ["", ".", ".."])
    def test_a_folder_is_no_output(self, dslam: Run, source: Path, folder: str) -> None:
        assert_refused(dslam("optimize", source, "-o", folder), "is a folder")

    def test_false_closures_are_rejected(self, dslam: Run, source: Path, tmp_path: Path) -> None:
        output = tmp_path / "out.g2o"
        result = dslam("optimize", source, "-o", output)
        assert (result.code, result.err) == (0, "")
        assert f"{TRUE + FALSE}: {TRUE} kept, {FALSE} rejected" in result.out
        assert "120 vertices, 159 edges, 3-D" in result.out
        before, after = (read_pose_graph(path).graph for path in (source, output))
        assert rmse_m(after) < 0.5
        np.testing.assert_array_equal(after.edges, before.edges)
        np.testing.assert_allclose(after.T_from_to, before.T_from_to, atol=1e-12)
        np.testing.assert_array_equal(after.information, before.information)
        closures = json.loads((tmp_path / "out.json").read_text())["closures"]
        assert [[c["from"], c["to"]] for c in closures] == before.edges[before.find_closures()].tolist()
        assert all(c["weight"] > 0.02 and c["kept"] for c in closures[:TRUE])
        assert all(c["weight"] < 0.01 and not c["kept"] for c in closures[TRUE:])
        assert sorted(p.name for p in tmp_path.iterdir()) == ["in.g2o", "out.g2o", "out.json"]

    def test_plain_least_squares_follows_them(self, dslam: Run, source: Path, tmp_path: Path) -> None:
        output = tmp_path / "out.g2o"
        assert dslam("optimize", source, "-o", output, "--plain").code == 0
        assert rmse_m(read_pose_graph(output).graph) > 5.0

    def test_the_same_input_gives_the_same_bytes(self, dslam: Run, source: Path, tmp_path: Path) -> None:
        for name in ("a", "b"):
            dslam("optimize", source, "-o", tmp_path / f"{name}.g2o", "--weights", tmp_path / f"{name}.txt")
        assert (tmp_path / "a.g2o").read_bytes() == (tmp_path / "b.g2o").read_bytes()
        assert (tmp_path / "a.txt").read_bytes() == (tmp_path / "b.txt").read_bytes()

    def test_json(self, dslam: Run, source: Path, tmp_path: Path) -> None:
        result = dslam("optimize", source, "-o", tmp_path / "out.g2o", "--json")
        summary = json.loads(result.out)
        assert summary["converged"] is True
        assert (summary["kept_count"], summary["rejected_count"]) == (TRUE, FALSE)
        assert summary["error_after"] < summary["error_before"]
        assert summary["weights"] == str(tmp_path / "out.json")

    def test_what_does_not_converge_exits_with_1(self, dslam: Run, source: Path, tmp_path: Path) -> None:
        result = dslam("optimize", source, "-o", tmp_path / "out.g2o", "--max-iterations", 1)
        assert result.code == 1
        assert result.err.startswith("dslam: not converged: ")
        assert result.err.count("\n") == 1
        assert json.loads((tmp_path / "out.json").read_text())["converged"] is False
        assert (tmp_path / "out.g2o").exists()

    def test_planar_stays_planar(self, dslam: Run, tmp_path: Path) -> None:
        source, output = tmp_path / "in.g2o", tmp_path / "out.g2o"
        source.write_text(LINE + "EDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\nLANDMARK2 3 0 0\n")
        result = dslam("optimize", source, "-o", output)
        assert result.code == 0
        assert "1 LANDMARK2" in result.out
        assert output.read_text().splitlines()[:3] == [f"VERTEX_SE2 {i} {float(i)} 0.0 0.0" for i in range(3)]

    def test_refusals(self, dslam: Run, source: Path, tmp_path: Path) -> None:
        bad, output = tmp_path / "bad.g2o", tmp_path / "out.g2o"
        bad.write_text(LINE + "EDGE_SE2 1 2 nan 0 0 1 0 0 1 0 1\n")
        assert_refused(dslam("optimize", bad, "-o", output), "bad.g2o, line 2", "not finite")
        bad.write_text(LINE + "EDGE_SE2 7 8 1 0 0 1 0 0 1 0 1\n")
        assert_refused(dslam("optimize", bad, "-o", output), "falls into parts", "vertex 7, 8")
        assert_refused(dslam("optimize", tmp_path / "none.g2o", "-o", output), "none.g2o")
        assert_refused(dslam("optimize", source, "-o", source), "is the input")
        assert_refused(dslam("optimize", source, "-o", tmp_path / "out.json"), "two outputs")
        assert_refused(dslam("optimize", source, "-o", tmp_path / "none" / "out.g2o"), "no folder")
        assert not list(tmp_path.glob("out*"))


def write_map(path: Path, graph: PoseGraph, *, truth: bool = True) -> Path:
    """What a replay leaves behind, as far as the benchmark reads it."""
    kinds = tuple("closure" if closes else "odometry" for closes in graph.find_closures())
    stamps_ns = 10**9 * (1 + np.arange(VERTICES))
    nothing = np.zeros(0, dtype=np.int64)
    record = FactorGraphRecord(
        stamp_ns=int(stamps_ns[-1]),
        keyframe_ids=graph.vertex_ids,
        keyframe_stamps_ns=stamps_ns,
        T_map_body=graph.T_world_vertex,
        edge_keyframe_ids=graph.edges,
        edge_transforms=graph.T_from_to,
        edge_covariances=np.linalg.inv(graph.information),
        edge_kinds=kinds,
        observation_keyframe_ids=nothing,
        observation_landmark_ids=(),
        observation_positions=np.zeros((0, 3)),
        observation_covariances=np.zeros((0, 3, 3)),
    )
    with LogWriter(path) as writer:
        if truth:
            for stamp_ns, T_world_body in zip(stamps_ns.tolist(), true_poses(), strict=True):
                writer.write("/ground_truth", GroundTruthPose(stamp_ns, T_world_body))
        writer.write("/slam/graph", record)
    return path


class TestBenchmarkClosures:
    def runs(self, dslam: Run, *arguments: object) -> list[dict[str, object]]:
        result = dslam("benchmark", "closures", *arguments, "--json")
        assert result.code == 0, result.err
        return list(json.loads(result.out)["runs"])

    def test_random_closures_cost_nothing(self, dslam: Run, tmp_path: Path) -> None:
        log = write_map(tmp_path / "map.mcap", with_false(TRUE, 5))
        odometry, clean, mixed, false = self.runs(dslam, log, "--kind", "random", "--seeds", 1)
        assert [run["case"] for run in (odometry, clean, mixed, false)] == ["odometry", "clean", "random", "random"]
        assert clean["closure_count"] == TRUE  # the log's false ones are left out
        assert mixed["closure_count"] == 4 * TRUE
        assert false["closure_count"] == 3 * TRUE
        assert clean["ate_m"] < 0.7 * odometry["ate_m"]
        assert mixed["ate_m"] < 1.2 * clean["ate_m"]
        assert false["ate_m"] < 1.1 * odometry["ate_m"]
        assert mixed["true_kept_share"] > 0.9
        assert mixed["false_kept_share"] == 0.0
        assert false["true_kept_share"] is None

    def test_a_back_end_that_trusts_everything_fails_it(
        self, dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The twin: without a kernel, and nothing is taken out."""
        monkeypatch.setattr("slam.backend.pose_graph.robust_optimization._with_kernel", lambda factor, *_: factor)
        monkeypatch.setattr("slam.backend.pose_graph.robust_optimization.MIN_WEIGHT", 0.0)
        log = write_map(tmp_path / "map.mcap", with_false(TRUE, 0))
        _, clean, mixed, _ = self.runs(dslam, log, "--kind", "random", "--seeds", 1)
        assert mixed["ate_m"] > 3.0 * clean["ate_m"]

    def test_closures_from_the_truth(self, dslam: Run, tmp_path: Path) -> None:
        log = write_map(tmp_path / "map.mcap", with_false(0, 0))
        assert_refused(dslam("benchmark", "closures", log), "no true closure", "--from-truth")
        runs = self.runs(dslam, log, "--from-truth", 10, "--kind", "shifted", "--false-share", 0.5, "--seeds", 2)
        assert [run["case"] for run in runs] == ["odometry", *["clean", "shifted", "shifted"] * 2]
        assert runs[1]["closure_count"] > 3
        assert runs[2]["closure_count"] == 2 * runs[1]["closure_count"]
        text = dslam("benchmark", "closures", log, "--from-truth", 10, "--kind", "shifted", "--seeds", 1)
        assert "shifted, 75 % false" in text.out
        assert "shifted, all false" in text.out

    def test_refusals(self, dslam: Run, tmp_path: Path) -> None:
        log = write_map(tmp_path / "map.mcap", with_false(TRUE, 0), truth=False)
        assert_refused(dslam("benchmark", "closures", log), "0 of 120 keyframes have a true pose")
        assert_refused(dslam("benchmark", "closures", log, "--kind", "odd"), "random, aliased, shifted")
        assert_refused(dslam("benchmark", "closures", log, "--false-share", 1), "--false-share")
        straight = with_false(0, 0)
        T_gt = transform_from_xyz_yaw(np.arange(3.0 * VERTICES).reshape(-1, 3), np.zeros(VERTICES))
        log = write_map(tmp_path / "straight.mcap", replace(straight, T_world_vertex=T_gt), truth=True)
        assert dslam("benchmark", "closures", log, "--kind", "random").code == 2
