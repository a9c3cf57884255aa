"""What the command line refuses: one line on standard error, exit code 2, nothing written."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from logs.reader import LogReader
from tests.tools.runs import SAMPLE, Run, assert_refused, write_log


class TestRefusals:
    @pytest.mark.parametrize("command", ["info", "replay", "evaluate", "export"])
    def test_input_that_is_no_log(self, dslam: Run, tmp_path: Path, command: str) -> None:
        more = {"replay": ["-o", tmp_path / "out.mcap"], "export": ["--tum", tmp_path / "out.txt"]}.get(command, [])
        empty, text = tmp_path / "empty.mcap", tmp_path / "text.mcap"
        empty.touch()
        text.write_text("no log, but long enough to have a signature")
        assert_refused(dslam(command, tmp_path / "none.mcap", *more), "none.mcap", "No such file")
        assert_refused(dslam(command, empty, *more), "empty.mcap", "is empty")
        assert_refused(dslam(command, text, *more), "text.mcap", "not an MCAP")
        assert_refused(dslam(command, tmp_path, *more), "directory")
        assert not list(tmp_path.glob("out*"))

    @pytest.mark.parametrize("missing", ["odometry", "detections"])
    def test_topic_that_is_missing(self, dslam: Run, tmp_path: Path, missing: str) -> None:
        log = write_log(tmp_path / "log.mcap", **{missing: ()})
        there = "/objects" if missing == "odometry" else "/odom"
        assert_refused(dslam("replay", log, "-o", tmp_path / "out.mcap"), f"no topic gives {missing}", there)

    def test_several_topics_that_fit(self, dslam: Run, tmp_path: Path) -> None:
        log = write_log(tmp_path / "log.mcap", odometry=("/visual", "/wheels"))
        output = tmp_path / "out.mcap"
        assert_refused(dslam("replay", log, "-o", output), "/visual, /wheels", "--topic odometry=/visual")
        assert dslam("replay", log, "-o", output, "--topic", "odometry=/wheels").code == 0
        assert_refused(dslam("replay", log, "-o", output, "--topic", "odometry=/none"), "/none", "/wheels")
        assert_refused(dslam("replay", log, "-o", output, "--topic", "speed=/wheels"), "unknown part")
        assert_refused(dslam("replay", log, "-o", output, "--topic", "/wheels"), "KIND=/TOPIC")

    def test_settings(self, dslam: Run, tmp_path: Path) -> None:
        replay = ("replay", SAMPLE, "-o", tmp_path / "out.mcap")
        assert_refused(dslam(*replay, "--set", "keyframe.distance=2"), "did you mean keyframe.distance_m?")
        assert_refused(dslam(*replay, "--set", "keyframe.distance_m=-2"), "keyframe.distance_m=-2", "greater than 0")
        assert_refused(dslam(*replay, "--config", tmp_path / "none.toml"), "none.toml")
        assert_refused(dslam("simulate", tmp_path / "out.mcap", "--set", "sensor.dropout=2"), "less than or equal to 1")
        assert_refused(dslam("simulate", tmp_path / "out.mcap", "--set", "drive.speed_mps=-1"), "drive.speed_mps")
        assert not list(tmp_path.iterdir())

    def test_a_descriptor_that_does_not_exist(self, dslam: Run, tmp_path: Path) -> None:
        output = tmp_path / "out.mcap"
        result = dslam("replay", SAMPLE, "-o", output, "--set", "loop_closure.descriptor=rings")
        assert_refused(result, "rings", "descriptellation_lr")
        assert not output.exists()

    def test_output_that_cannot_be(self, dslam: Run, tmp_path: Path) -> None:
        nowhere = tmp_path / "none" / "out.mcap"
        assert_refused(dslam("replay", SAMPLE, "-o", nowhere), "no folder")
        assert_refused(dslam("replay", SAMPLE, "-o", tmp_path), "is a folder")
        assert_refused(dslam("replay", SAMPLE, "-o", tmp_path / "a.mcap", "--picture", nowhere), "no folder")
        for folder in ("", ".", "..", "/"):
            assert_refused(dslam("replay", SAMPLE, "-o", folder), "is a folder")
        assert_refused(dslam("simulate", nowhere), "no folder")
        assert not list(tmp_path.iterdir())

    def test_output_that_is_a_link_to_itself(self, dslam: Run, tmp_path: Path) -> None:
        loop = tmp_path / "loop.mcap"
        loop.symlink_to(loop)
        assert dslam("replay", SAMPLE, "-o", loop).code == 0
        assert not loop.is_symlink()

    def test_output_that_is_the_input(self, dslam: Run, tmp_path: Path) -> None:
        log = write_log(tmp_path / "log.mcap")
        before = log.read_bytes()
        (tmp_path / "link.mcap").symlink_to(log)
        assert_refused(dslam("replay", log, "-o", log), "is the input")
        assert_refused(dslam("replay", log, "-o", tmp_path / "link.mcap"), "is the input")
        assert_refused(dslam("export", log, "--tum", log), "is the input")
        assert_refused(dslam("evaluate", log, "--picture", log), "is the input")
        assert log.read_bytes() == before

    @pytest.mark.parametrize("kidnap", ["100", "a:b", "-1:5", "5:", "nan:5", "1e9:5", "5:1e9"])
    def test_kidnapping_that_cannot_be(self, dslam: Run, tmp_path: Path, kidnap: str) -> None:
        assert_refused(dslam("simulate", tmp_path / "out.mcap", "--length", 50, f"--kidnap={kidnap}"))
        assert not list(tmp_path.iterdir())

    def test_simulation_that_cannot_be(self, dslam: Run, tmp_path: Path) -> None:
        output = tmp_path / "out.mcap"
        assert_refused(dslam("simulate", output, "--seed", -1), "--seed", "greater than or equal to 0")
        assert_refused(dslam("simulate", output, "--length", 0), "above 0 m")
        assert_refused(dslam("simulate", output, "--length", 1), "too short")
        assert_refused(dslam("simulate", output, "--objects", "objects.csv"), "--trajectory")
        assert_refused(dslam("simulate", output, "--objects", "a.csv", "--trajectory", "b.csv"), "a.csv")

    def test_import_without_its_files(self, dslam: Run, tmp_path: Path) -> None:
        files = ("--detections", "a", "--odometry", "b.txt", "--calib", "c.txt", "--times", "d.txt")
        assert_refused(dslam("import", "kitti-objects", tmp_path / "out.mcap", *files), "a/bow.txt")

    @pytest.mark.slow
    def test_view_of_a_truncated_log(self, dslam: Run, mapped: Path, tmp_path: Path) -> None:
        pytest.importorskip("rerun", reason="Rerun is an extra: pip install 'descriptellation-slam[view]'")
        (tmp_path / "cut.mcap").write_bytes(mapped.read_bytes()[:-100])
        result = dslam("view", tmp_path / "cut.mcap", "--save", tmp_path / "cut.rrd")
        assert_refused(result, "Rerun cannot read", "make the log again")

    def test_log_without_an_estimate(self, dslam: Run, tmp_path: Path) -> None:
        assert_refused(dslam("evaluate", SAMPLE), "no estimate", "dslam replay")
        assert_refused(dslam("export", SAMPLE, "--tum", tmp_path / "out.txt"), "no final trajectory")
        assert_refused(dslam("export", SAMPLE), "--tum")

    def test_an_error_that_nobody_expected(self, dslam: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail(*_: object) -> None:
            raise ZeroDivisionError("one\nof ours")

        monkeypatch.setattr("logs.summary.summarize", fail)
        assert_refused(dslam("info", SAMPLE), "ZeroDivisionError: one of ours", "--debug", code=70)
        result = dslam("info", SAMPLE, "--debug")
        assert result.code == 70
        assert "Traceback" in result.err
        assert "report" in result.err.splitlines()[-1]

    def test_a_module_of_an_extra_that_is_not_installed(self, dslam: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail(*_: object) -> None:
            raise ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn")

        monkeypatch.setattr("logs.summary.summarize", fail)
        assert_refused(dslam("info", SAMPLE), "this needs torch.nn", "pip install 'descriptellation-slam[learn]'")

    def test_a_picture_without_matplotlib_is_refused_before_the_drive_is_mapped(
        self, dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setitem(sys.modules, "matplotlib", None)
        result = dslam("replay", SAMPLE, "-o", tmp_path / "map.mcap", "--picture", tmp_path / "map.png")
        assert_refused(result, "this needs matplotlib", "pip install 'descriptellation-slam[pictures]'")
        assert not list(tmp_path.iterdir())

    def test_interruption(self, dslam: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        def interrupt(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr("logs.summary.summarize", interrupt)
        assert_refused(dslam("info", SAMPLE), "interrupted", code=130)


class TestOutputs:
    def test_two_outputs_are_not_one_file(self, dslam: Run, tmp_path: Path) -> None:
        both = tmp_path / "both.mcap"
        result = dslam("replay", SAMPLE, "-o", both, "--picture", both)
        assert result.code == 2
        assert "two outputs" in result.err
        assert not both.exists()

    @pytest.mark.parametrize("second", ["a.txt", "./a.txt", "link.txt", "a.txt.part"])
    def test_nor_are_a_name_and_its_partial_name(self, dslam: Run, mapped: Path, tmp_path: Path, second: str) -> None:
        (tmp_path / "link.txt").symlink_to(tmp_path / "a.txt")
        names = (tmp_path / "a.txt", f"{tmp_path}/{second}")
        for first, other in (names, names[::-1]):
            assert_refused(dslam("export", mapped, "--tum", first, "--kitti", other), "two outputs")
            assert_refused(dslam("evaluate", mapped, "--json-file", first, "--picture", other), "two outputs")
        assert not (tmp_path / "a.txt").exists()

    def test_an_input_under_the_partial_name_of_the_output_is_kept(
        self, dslam: Run, mapped: Path, tmp_path: Path
    ) -> None:
        log = tmp_path / "a.txt.part"
        log.write_bytes(mapped.read_bytes())
        assert_refused(dslam("export", log, "--tum", tmp_path / "a.txt"), "is the input")
        assert log.read_bytes() == mapped.read_bytes()

    def test_a_reference_without_truth_is_refused(self, dslam: Run, tmp_path: Path) -> None:
        output, reference = tmp_path / "map.mcap", write_log(tmp_path / "reference.mcap")
        assert dslam("replay", SAMPLE, "-o", output).code == 0
        result = dslam("evaluate", output, "--reference", reference)
        assert result.code == 2
        assert "the reference holds no truth" in result.err

    def test_a_kidnapping_keeps_the_gap_that_is_set(self, dslam: Run, tmp_path: Path) -> None:
        settings = tmp_path / "gap.toml"
        settings.write_text("[kidnap]\nfrom_m = 1.0\nto_m = 2.0\ngap_s = 60.0\n")
        log = tmp_path / "log.mcap"
        result = dslam("simulate", log, "--length", 80, "--kidnap", "30:50", "--config", settings)
        assert result.code == 0
        assert json.loads(dslam("info", log, "--json").out)["duration_s"] > 60.0

    def test_a_kidnapping_joins_what_is_set(self, dslam: Run, tmp_path: Path) -> None:
        log = tmp_path / "log.mcap"
        simulate = ("simulate", log, "--length", 80, "--set", "kidnap.gap_s=30")
        assert_refused(dslam(*simulate), "--set: kidnap.from_m is missing")
        result = dslam(*simulate, "--set", "kidnap.from_m=10", "--kidnap", "30:50")
        assert result.code == 0, result.err
        with LogReader(log) as reader:
            configuration = json.loads(reader.metadata()["simulation"]["configuration"])
        assert {"from_m": 30.0, "to_m": 50.0, "gap_s": 30.0}.items() <= configuration["kidnap"].items()
