from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from slam.common.errors import FleetError
from slam.fleet.engine import ProcessEngine, RayEngine, open_engine
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
def test_all_tasks_are_computed(workers: int) -> None:
    assert dict(ProcessEngine(workers).compute(doubled, [1, 2, 3])) == {1: 2, 2: 4, 3: 6}


@pytest.mark.slow
def test_a_task_whose_process_dies_is_begun_again(tmp_path: Path) -> None:
    tasks = [tmp_path / name for name in "ab"]
    assert dict(ProcessEngine(2).compute(die_once, tasks)) == dict.fromkeys(tasks, "done")


@pytest.mark.slow
def test_a_task_that_always_kills_its_process_is_given_up() -> None:
    assert isinstance(dict(ProcessEngine(1).compute(die_always, [1]))[1], Death)


@pytest.mark.slow
def test_ray_computes_the_same_and_begins_tasks_again(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed")
    tasks = [tmp_path / name for name in "ab"]
    with open_engine(2) as engine:
        assert dict(engine.compute(doubled, [1, 2, 3])) == {1: 2, 2: 4, 3: 6}
        assert dict(engine.compute(die_once, tasks)) == dict.fromkeys(tasks, "done")


def test_a_cluster_needs_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(FleetError, match="pip install"), open_engine(2, address="10.0.0.1:6379"):
        pass


def test_a_cluster_that_does_not_come_up_is_told_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray", reason="Ray is not installed")

    def init(**_: object) -> None:
        raise Exception("the node timed out\nand much more")

    monkeypatch.setattr(ray, "init", init)
    with pytest.raises(FleetError, match=r"Ray cannot be started on this machine: the node timed out$"), open_engine(1):
        pass


class FailingRay:
    """Ray whose one task ends in an error."""

    def __init__(self, error: Exception) -> None:
        self.exceptions = pytest.importorskip("ray.exceptions", reason="Ray is not installed")
        self._error = error

    def remote(self, **_: object) -> Callable[[Callable[[int], int]], Any]:
        return lambda function: SimpleNamespace(remote=function)

    def wait(self, running: list[int], **_: object) -> tuple[list[int], list[int]]:
        return running[:1], running[1:]

    def get(self, _: int) -> int:
        raise self._error


def test_a_failure_of_ray_itself_is_told_in_a_line() -> None:
    errors = pytest.importorskip("ray.exceptions", reason="Ray is not installed")
    engine = RayEngine(FailingRay(errors.LocalRayletDiedError()))
    with pytest.raises(FleetError, match=r"^Ray failed: .*raylet died.* The same command goes on from here\.$"):
        list(engine.compute(doubled, [1]))


def test_what_a_task_raises_is_raised() -> None:
    errors = pytest.importorskip("ray.exceptions", reason="Ray is not installed")
    with pytest.raises(errors.RayTaskError):
        list(RayEngine(FailingRay(errors.RayTaskError("doubled", "", ValueError("a bug")))).compute(doubled, [1]))
