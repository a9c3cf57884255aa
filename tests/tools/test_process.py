"""``dslam`` as a process: streams that are closed or full, locales without umlauts, signals."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from logs.messages import ObjectDetections, Odometry
from logs.reader import LogReader
from logs.writer import LogWriter
from tests.tools.runs import ROOT, SAMPLE, Run, run_python

INFO = f"{sys.executable} -m dslam info {SAMPLE}"


def shell(command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, **environment}
    line = ["bash", "-c", command]
    return subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False, env=variables)


@pytest.fixture(scope="module")
def odd_names(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with names that a terminal, a terminal's library or a picture would interpret."""
    path = tmp_path_factory.mktemp("names") / "log.mcap"
    labels = ("Bäume", "[red]x[/red]", "\x1b[2J", "[/]", "$\\frac{1}{$", "\u202egpj", "_hidden", "\U0001f980")
    with LogWriter(path) as writer:
        for stamp in range(1, 40):
            writer.write("/odom", Odometry(stamp * 10**8, np.eye(4), "[bold]odom", "\x1b]0;x\x07"))
            record = ObjectDetections(stamp * 10**8, "\x1b]0;x\x07", np.ones((8, 3)) * 5, labels, np.ones(8))
            writer.write("/[/]objects\x1b[31m", record)
    return path


def test_names_are_shown_as_they_stand(dslam: Run, odd_names: Path) -> None:
    result = dslam("info", odd_names)
    assert result.code == 0
    assert "\x1b" not in result.out + result.err
    for text in ("[red]x[/red]", "\\x1b[2J", "[bold]odom", "/[/]objects\\x1b[31m", "Bäume", "\\u202egpj"):
        assert text in result.out


def test_names_are_not_interpreted_in_messages(dslam: Run, odd_names: Path, tmp_path: Path) -> None:
    result = dslam("replay", odd_names, "-o", tmp_path / "out.mcap", "--topic", "odometry=/\x1b[31m")
    assert result.code == 2
    assert "\x1b" not in result.err
    assert "\\x1b[31m" in result.err


def test_names_in_a_locale_without_umlauts(odd_names: Path) -> None:
    result = shell(
        f"{sys.executable} -m dslam info {odd_names}",
        LC_ALL="C", PYTHONCOERCECLOCALE="0", PYTHONUTF8="0", PYTHONIOENCODING="ascii:strict",
    )  # fmt: skip
    assert (result.returncode, result.stderr) == (0, "")
    assert "B\\xe4ume" in result.stdout


@pytest.mark.parametrize("closed", [">&-", "2>&-"])
def test_closed_streams(closed: str) -> None:
    result = shell(f"{INFO} {closed}")
    assert result.returncode == 0
    assert result.stderr == ""


def test_a_refusal_without_standard_error(tmp_path: Path) -> None:
    assert shell(f"{sys.executable} -m dslam info {tmp_path}/none 2>&-").returncode == 2
    assert shell(f"{sys.executable} -m dslam info {tmp_path}/none 2>/dev/full").returncode == 2


def test_full_and_broken_streams() -> None:
    result = shell(f"{INFO} > /dev/full")
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "No space left" in result.stderr
    assert shell(f"{INFO} | true").stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_while_mapping_name_what_is_left(tmp_path: Path, number: signal.Signals) -> None:
    output, part = tmp_path / "out.mcap", tmp_path / "out.mcap.part"
    command = [sys.executable, "-m", "dslam", "replay", str(SAMPLE), "-o", str(output)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60.0
    while not (part.exists() and part.stat().st_size) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(number)
    _, told = process.communicate(timeout=600)
    assert process.returncode == 128 + number
    assert told.count("\n") == 1
    assert str(part) in told
    assert not output.exists()
    with LogReader(part) as reader:
        assert reader.topics() is not None


def test_signal_while_importing_is_one_line() -> None:
    code = (
        "import os, signal, sys, tools\n"
        "class Finder:\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'tools.cli': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "tools.main()"
    )
    result = run_python("-c", code)
    assert (result.code, result.err) == (130, "dslam: interrupted\n")
