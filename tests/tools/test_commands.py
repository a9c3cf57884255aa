"""What the commands do when all is well, and requirements."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import LoopClosureRecord, Odometry
from logs.writer import LogWriter
from tests.tools.runs import SAMPLE, Run, assert_refused, write_log
from tools import console

pytestmark = pytest.mark.slow


class TestJson:
    def test_each_prints_one_object(self, dslam: Run, mapped: Path, tmp_path: Path) -> None:
        for arguments in (
            ("simulate", tmp_path / "a.mcap", "--length", 20),
            ("info", SAMPLE),
            ("info", mapped),
            ("replay", SAMPLE, "-o", tmp_path / "c.mcap"),
            ("evaluate", mapped),
            ("config",),
            ("config", "--simulation"),
        ):
            result = dslam(*arguments, "--json")
            assert result.code == 0, result.err
            assert result.err == ""
            told = json.loads(result.out)
            assert isinstance(told, dict)
            if arguments[0] == "replay":
                assert told["counters"]["odometry_used"] == 164
                assert told["counters"]["landmarks_confirmed"] > 20

    def test_evaluation_goes_to_a_file_too(self, dslam: Run, mapped: Path, tmp_path: Path) -> None:
        written = tmp_path / "written.json"
        assert dslam("evaluate", mapped, "--json-file", written).code == 0
        assert json.loads(dslam("evaluate", "--json", mapped).out) == json.loads(written.read_text())


class TestRequirements:
    def test_met(self, dslam: Run, mapped: Path) -> None:
        bars = ("--require", "trajectory.ate_m<=1.0", "--require", "landmarks.precision>=0.5")
        result = dslam("evaluate", mapped, *bars)
        assert result.code == 0
        met = [line for line in result.out.splitlines() if line.startswith("met: ")]
        assert [line.split()[1] for line in met] == ["trajectory.ate_m", "landmarks.precision"]
        assert met[0].endswith(" <= 1")

    def test_not_met(self, dslam: Run, mapped: Path) -> None:
        result = dslam("evaluate", mapped, "--require", "trajectory.ate_m<=0.000001")
        assert result.code == 1
        assert "ATE" in result.out
        assert "met:" not in result.out
        assert result.err.count("\n") == 1
        assert "trajectory.ate_m is" in result.err

    def test_malformed(self, dslam: Run, mapped: Path) -> None:
        assert_refused(dslam("evaluate", mapped, "--require", "trajectory.ate_m=4"), "expected for example")


class TestFromEndToEnd:
    def test_simulate_replay_evaluate_export(self, dslam: Run, tmp_path: Path) -> None:
        drive, output, picture = tmp_path / "drive.mcap", tmp_path / "map.mcap", tmp_path / "map.png"
        settings = ("--set", "sensor.dropout=0.2", "--set", "traffic.vehicles=1")
        made = dslam("simulate", drive, "--seed", 2, "--length", 100, *settings)
        assert made.code == 0
        assert "street-grid (seed 2)" in " ".join(made.out.split())
        replayed = dslam("replay", drive, "-o", output, "--picture", picture, "--set", "keyframe.distance_m=3")
        assert replayed.code == 0
        assert replayed.err == ""  # no progress where there is no terminal
        assert "confirmed" in replayed.out
        assert picture.read_bytes().startswith(b"\x89PNG")
        evaluated = dslam("evaluate", output, "--require", "trajectory.ate_m<=1.0", "--rules")
        assert evaluated.code == 0
        assert "rules" in evaluated.out
        tum, kitti, g2o = (tmp_path / name for name in ("tum.txt", "kitti.txt", "graph.g2o"))
        assert dslam("export", output, "--tum", tum, "--kitti", kitti, "--g2o", g2o).code == 0
        assert np.loadtxt(tum).shape[1] == 8
        assert np.loadtxt(kitti).shape[1] == 12
        assert "VERTEX_TRACKXYZ" in g2o.read_text()
        assert not list(tmp_path.glob("*.part"))

    def test_info_of_an_input(self, dslam: Run) -> None:
        result = dslam("info", SAMPLE)
        assert result.code == 0
        for text in ("/odom as odometry", "/detections as detections", "foxglove.Odometry", "tree", "base_link"):
            assert text in result.out

    def test_info_of_an_output(self, dslam: Run, tmp_path: Path) -> None:
        output = tmp_path / "map.mcap"
        settings = ("--set", "loop_closure.top_k=7", "--set", "calibrate=false")
        assert dslam("replay", SAMPLE, "-o", output, *settings).code == 0
        result = dslam("info", output, "--closures")
        for text in (
            "defaults, but calibrate=false, loop_closure.top_k=7",
            "dslam: version",
            "landmarks_confirmed",
            "map of another log",
        ):
            assert text in result.out
        assert "no loop-closure candidate" in result.out

    def test_info_lists_loop_closures(self, dslam: Run, tmp_path: Path) -> None:
        log = tmp_path / "log.mcap"
        with LogWriter(log) as writer:
            writer.write("/odom", Odometry(10**18, np.eye(4)), 10**18)
            for query in range(60):
                stage = "accepted" if query == 50 else "registration"
                record = LoopClosureRecord(
                    10**18 + query * 10**9, query, 0, query == 50, stage, f"{query} of [tree] agree", 0.1, score=np.inf
                )
                if query == 50:
                    record = replace(record, log_likelihood_ratio=23.5, odometry_penalty=1.25)
                writer.write("/slam/closures", record, 10**18)
        out = dslam("info", log, "--closures").out
        assert "# of [tree] agree" in out
        listed = [line.split()[:3] for line in out.splitlines() if line.endswith(" of [tree] agree")]
        assert listed == [[str(query), "0", f"{query}.0"] for query in range(40)]
        assert "and 20 more" in out
        assert dslam("info", log, "--all").out.count("registration  ") == 59 + 1
        _, heading, row = dslam("info", log, "--keyframe", 50).out.splitlines()
        assert {"LLR", "penalty"} < set(heading.split())
        assert row.split()[3:6] == ["inf", "23.5", "1.25"]
        assert "keyframe 60 is not the query of a loop-closure candidate" in dslam("info", log, "--keyframe", 60).out
        assert "closure_candidates" not in json.loads(dslam("info", log, "--json").out)
        every = json.loads(dslam("info", log, "--json", "--closures").out)["closure_candidates"]
        assert [candidate["query_keyframe_id"] for candidate in every] == list(range(60))
        assert (every[50]["time_s"], every[50]["accepted"], every[50]["score"]) == (50.0, True, None)

    def test_info_says_why_a_replay_cannot_be(self, dslam: Run, tmp_path: Path) -> None:
        log = write_log(tmp_path / "log.mcap", detections=())
        result = dslam("info", log)
        assert result.code == 0
        assert "no topic gives detections" in result.out

    @pytest.mark.parametrize("width", [20, 40])
    def test_a_narrow_terminal_loses_no_digit(
        self, dslam: Run, mapped: Path, monkeypatch: pytest.MonkeyPatch, width: int
    ) -> None:
        wide = dslam("evaluate", mapped, "--all").out
        monkeypatch.setattr(console, "PIPE_WIDTH", width)
        narrow = dslam("evaluate", mapped, "--all").out
        numbers = re.compile(r"\d+\.\d+(?!\S)")
        assert sorted(numbers.findall(narrow)) == sorted(numbers.findall(wide))

    def test_six_lines_unless_all_is_asked_for(self, dslam: Run, mapped: Path) -> None:
        lines = dslam("evaluate", mapped).out.splitlines()
        assert [line.split()[0] for line in lines if not line.startswith(" ")] == [
            "trajectory", "landmarks", "associations", "closures", "relocalization", "calibration"
        ]  # fmt: skip
        assert "estimate.ate_m" in dslam("evaluate", mapped, "--all").out

    def test_configuration_goes_round(self, dslam: Run, tmp_path: Path) -> None:
        path = tmp_path / "mine.toml"
        printed = dslam("config", "--set", "keyframe.distance_m=1.5").out
        assert "distance_m = 1.5" in printed
        path.write_text(printed)
        assert json.loads(dslam("config", "--config", path, "--json").out)["keyframe"]["distance_m"] == 1.5
