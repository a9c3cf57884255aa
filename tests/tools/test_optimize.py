"""dslam optimize."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from slam.backend.pose_graph import pose_graph_optimization
from slam.formats.g2o import read_pose_graph, write_pose_graph
from tests.helpers.pose_graphs import rmse_m, with_false
from tests.tools.runs import Run, assert_refused

TRUE, FALSE = 16, 24
LINE = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "in.g2o"
    write_pose_graph(path, with_false(TRUE, FALSE))
    return path


class TestOptimize:
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
            dslam("optimize", source, "-o", tmp_path / f"{name}.g2o")
        assert (tmp_path / "a.g2o").read_bytes() == (tmp_path / "b.g2o").read_bytes()
        assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()

    def test_json(self, dslam: Run, source: Path, tmp_path: Path) -> None:
        result = dslam("optimize", source, "-o", tmp_path / "out.g2o", "--json")
        summary = json.loads(result.out)
        assert summary["converged"] is True
        assert (summary["kept_count"], summary["rejected_count"]) == (TRUE, FALSE)
        assert summary["error_after"] < summary["error_before"]
        assert summary["weights"] == str(tmp_path / "out.json")

    def test_what_does_not_converge_exits_with_1(
        self, dslam: Run, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        module = pose_graph_optimization
        monkeypatch.setattr(module, "optimize_pose_graph", partial(module.optimize_pose_graph, max_iterations=1))
        result = dslam("optimize", source, "-o", tmp_path / "out.g2o")
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
        assert_refused(dslam("optimize", bad, "-o", output), "not connected", "vertex 7, 8")
        assert_refused(dslam("optimize", tmp_path / "none.g2o", "-o", output), "none.g2o")
        assert_refused(dslam("optimize", source, "-o", source), "is the input")
        assert_refused(dslam("optimize", source, "-o", tmp_path / "out.json"), "two outputs")
        assert_refused(dslam("optimize", source, "-o", tmp_path / "none" / "out.g2o"), "no folder")
        assert not list(tmp_path.glob("out*"))
