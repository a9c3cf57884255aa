"""Processes that compute tasks."""

import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from slam.sweeps.workers import compute_all
from tests.tools.runs import ROOT

KILLED = """
import os, time
from slam.sweeps.workers import compute_all

def wait(number):
    os.write(1, str(number).encode())
    time.sleep(60)

if __name__ == "__main__":
    list(compute_all(wait, [1, 2], jobs=2))
"""


def die_over_three(number: int) -> tuple[int, int]:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number, os.getpid()


@pytest.mark.parametrize("jobs", [1, 2])
def test_dying_process_takes_only_its_task_along(jobs: int) -> None:
    outcomes = dict(compute_all(die_over_three, [1, 2, 3, 4], jobs=jobs))
    assert outcomes.pop(3) is None
    assert {task: outcome[0] for task, outcome in outcomes.items()} == {number: number for number in (1, 2, 4)}  # type: ignore[index]
    processes = {outcome[1] for outcome in outcomes.values()}  # type: ignore[index]
    assert len(processes | {os.getpid()}) == 4


def warn(name: str) -> str:
    logging.getLogger("slam").warning("of %s", name)
    return name


def test_what_a_process_logs_does_not_reach_the_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    assert dict(compute_all(warn, ["\x1b[2J"], jobs=1)) == {"\x1b[2J": "\x1b[2J"}
    assert capfd.readouterr().err == ""


def test_closing_begins_no_further_task(tmp_path: Path) -> None:
    tasks = [tmp_path / str(number) for number in range(4)]
    outcomes = compute_all(Path.touch, tasks, jobs=1)
    assert next(outcomes)[0] == tasks[0]
    outcomes.close()
    assert not tasks[3].exists()


def test_no_process_outlives_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(KILLED)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, env=environment) as process:
        assert set(process.stdout.read(2).decode()) == {"1", "2"}
        process.kill()
        # The pipe ends when the last process that holds it has ended; they would sleep for a minute.
        assert process.communicate(timeout=50) == (b"", None)
