"""Processes that compute tasks."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from slam.sweeps.workers import Death, compute_all

ROOT = Path(__file__).parents[3]

KILLED = """
import os, time
from slam.sweeps.workers import compute_all

def wait(number):
    os.write(1, str(number).encode())
    time.sleep(60)

if __name__ == "__main__":
    list(compute_all(wait, [1, 2], jobs=2))
"""


def square(number: int) -> int:
    return number * number


def die_over_three(number: int) -> tuple[int, int]:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number, os.getpid()


@pytest.mark.parametrize("jobs", [1, 2])
def test_compute_all_returns_every_outcome(jobs: int) -> None:
    assert dict(compute_all(square, range(7), jobs=jobs)) == {number: number**2 for number in range(7)}


@pytest.mark.parametrize("jobs", [1, 2])
def test_dying_process_takes_only_its_task_along(jobs: int) -> None:
    outcomes = dict(compute_all(die_over_three, [1, 2, 3, 4], jobs=jobs, fresh=True))
    assert outcomes.pop(3) == Death(-signal.SIGKILL)
    assert {task: outcome[0] for task, outcome in outcomes.items()} == {number: number for number in (1, 2, 4)}  # type: ignore[index]
    processes = {outcome[1] for outcome in outcomes.values()}  # type: ignore[index]
    assert len(processes | {os.getpid()}) == 4


def write_late(path: Path) -> None:
    if path.name == "late":
        time.sleep(5.0)
    path.touch()


def test_closing_stops_running_tasks(tmp_path: Path) -> None:
    outcomes = compute_all(write_late, [tmp_path / "soon", tmp_path / "late"], jobs=2)
    assert next(outcomes)[0] == tmp_path / "soon"
    outcomes.close()
    assert [path.name for path in tmp_path.iterdir()] == ["soon"]


def test_no_process_outlives_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(KILLED)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, env=environment) as process:
        assert set(process.stdout.read(2).decode()) == {"1", "2"}
        process.kill()
        # The pipe ends when the last process that holds it has ended; they would sleep for a minute.
        assert process.communicate(timeout=50) == (b"", None)
