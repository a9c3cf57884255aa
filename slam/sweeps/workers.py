"""Processes that compute tasks: one that dies takes only its task along, and none outlives its parent."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from threadpoolctl import threadpool_limits

_Task = TypeVar("_Task")
_Outcome = TypeVar("_Outcome")


@dataclass(frozen=True, slots=True)
class Death:
    """The process ended over its task; ``exit_code`` is negative for a signal, such as -9 where memory ran out."""

    exit_code: int | None


def compute_all(
    compute: Callable[[_Task], _Outcome], tasks: Sequence[_Task], *, jobs: int, fresh: bool = False
) -> Generator[tuple[_Task, _Outcome | Death], None, None]:
    """Each task with its outcome, as they finish; with one job in this process and in their order.

    Args:
        compute: a function of a module, which raises nothing; it runs on one thread.
        tasks: that can be pickled.
        jobs: processes at a time.
        fresh: a process of its own for each task, with one job too.
    """
    if jobs == 1 and not fresh:
        with threadpool_limits(1):
            for task in tasks:
                yield task, compute(task)
        return
    waiting = deque(tasks)
    workers = [_Worker[_Task, _Outcome](compute) for _ in range(min(jobs, len(tasks)))]
    try:
        for worker in workers:
            worker.begin(waiting.popleft())
        while busy := {worker.connection: worker for worker in workers if worker.task is not None}:
            for ready in wait(list(busy)):
                worker = busy[ready]  # type: ignore[index]
                finished = worker.finish()
                if fresh or isinstance(finished[1], Death):
                    workers.remove(worker)
                    worker.stop()
                    if waiting:
                        workers.append(worker := _Worker[_Task, _Outcome](compute))
                if waiting:
                    worker.begin(waiting.popleft())
                yield finished
    finally:
        for worker in workers:
            worker.stop()


class _Worker(Generic[_Task, _Outcome]):
    """One process, and the task that it is at."""

    def __init__(self, compute: Callable[[_Task], _Outcome]) -> None:
        spawn = multiprocessing.get_context("spawn")
        self.connection: Connection[Any, Any]
        self.connection, theirs = spawn.Pipe()
        self.task: _Task | None = None
        self._process: BaseProcess = spawn.Process(target=_serve, args=(compute, theirs), daemon=True)
        self._process.start()
        theirs.close()  # so that the death of the process ends the pipe

    def begin(self, task: _Task) -> None:
        self.task = task
        self.connection.send(task)

    def finish(self) -> tuple[_Task, _Outcome | Death]:
        """The task and what came of it; blocks until it is there."""
        assert self.task is not None
        task, self.task = self.task, None
        try:
            return task, self.connection.recv()
        except (EOFError, OSError):
            self._process.join()
            return task, Death(self._process.exitcode)

    def stop(self) -> None:
        self._process.kill()
        self._process.join()
        self.connection.close()


def _serve(compute: Callable[[Any], Any], connection: Connection[Any, Any]) -> None:
    """What a process does until its parent stops it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["OMP_NUM_THREADS"] = "1"  # for libraries that are loaded later
    with threadpool_limits(1):
        while True:
            connection.send(compute(connection.recv()))


def _end_with_parent() -> None:
    """A parent that was killed cannot stop its processes."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
