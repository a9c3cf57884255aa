"""Help, version, wrong usage, and the command as a process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools.runs import ROOT, SAMPLE, Run, assert_refused

COMMANDS = (
    *("simulate", "degrade", "import kitti-objects", "info", "replay", "evaluate"),
    *("compare", "sweep"),
    *("view", "export", "config"),
    *("relocalize", "train", "benchmark descriptors"),
    *("benchmark relocalization", "benchmark ablation"),
    *("benchmark robots", "benchmark recall", "benchmark retrieval", "benchmark fleet", "benchmark kidnapping"),
)


class TestHelp:
    @pytest.mark.parametrize("command", COMMANDS)
    def test_every_command_explains_itself_by_an_example(self, dslam: Run, command: str) -> None:
        result = dslam(*command.split(), "--help")
        assert result.code == 0
        assert result.err == ""
        assert f"Example: dslam {command}" in " ".join(result.out.split())

    def test_the_root_lists_the_commands(self, dslam: Run) -> None:
        result = dslam("--help")
        assert result.code == 0
        assert all(f" {command.split()[0]} " in result.out for command in COMMANDS)

    def test_without_a_command_the_help_and_exit_code_2(self, dslam: Run) -> None:
        result = dslam()
        assert result.code == 2
        assert "Usage" in result.out + result.err

    def test_version(self, dslam: Run) -> None:
        result = dslam("--version")
        assert (result.code, result.out.split()[0]) == (0, "dslam")

    @pytest.mark.parametrize(
        "arguments", [("fly",), ("info",), ("info", "a", "b"), ("info", "a", "--fast"), ("replay", "a")]
    )
    def test_wrong_usage_is_one_line(self, dslam: Run, arguments: tuple[str, ...]) -> None:
        assert_refused(dslam(*arguments), "--help")


class TestAsAProcess:
    def dslam(self, *arguments: object, **more: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "tools.cli", *map(str, arguments)]
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, **more)  # type: ignore[call-overload]

    @pytest.mark.slow
    def test_exit_codes(self, mapped: Path) -> None:
        assert self.dslam("--help").returncode == 0
        assert self.dslam("evaluate", mapped, "--require", "trajectory.ate_m<=0").returncode == 1
        refused = self.dslam("info", "none.mcap")
        assert refused.returncode == 2
        assert refused.stdout == ""
        assert refused.stderr.count("\n") == 1

    def test_a_pipe_that_breaks_is_quiet(self) -> None:
        command = f"{sys.executable} -m tools.cli info {SAMPLE} | true"
        result = subprocess.run(["bash", "-c", command], cwd=ROOT, capture_output=True, text=True, check=False)
        assert result.stderr == ""
