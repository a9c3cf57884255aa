from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from slam.fleet.tasks import compute_in_processes
from slam.sweeps.workers import Death


def doubled(task: int) -> int:
    return 2 * task


def die_once(task: Path) -> str:
    """The first process at a task is killed."""
    if task.exists():
        return "done"
    task.write_text("begun")
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60.0)
    return "never"


def die_always(task: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return task


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_compute_in_processes_computes_all_tasks(workers: int) -> None:
    assert dict(compute_in_processes(doubled, [1, 2, 3], workers=workers)) == {1: 2, 2: 4, 3: 6}


@pytest.mark.slow
def test_task_is_started_again_after_its_process_died(tmp_path: Path) -> None:
    tasks = [tmp_path / name for name in "ab"]
    assert dict(compute_in_processes(die_once, tasks, workers=2)) == dict.fromkeys(tasks, "done")


@pytest.mark.slow
def test_task_that_always_kills_its_process_is_given_up() -> None:
    assert isinstance(dict(compute_in_processes(die_always, [1], workers=1))[1], Death)
