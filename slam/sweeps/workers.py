"""Tasks in processes of their own: one that dies takes only its task along, and none outlives its parent."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

_Task = TypeVar("_Task")
_Outcome = TypeVar("_Outcome")


@dataclass(frozen=True, slots=True)
class Death:
    """The process ended over its task; ``exit_code`` is negative for a signal, such as -9 where memory ran out."""

    exit_code: int | None

    def __str__(self) -> str:
        return f"the process ended without a result (exit code {self.exit_code}); check the memory, try fewer jobs"


def compute_all(
    compute: Callable[[_Task], _Outcome], tasks: Sequence[_Task], *, jobs: int, fresh: bool = False
) -> Generator[tuple[_Task, _Outcome | Death], None, None]:
    """Each task with its outcome, as they finish; with one job in this process and in their order.

    Args:
        compute: a function of a module, which raises nothing; it runs on one thread.
        tasks: that can be pickled.
        jobs: tasks at a time, each in a new process.
        fresh: a process for each task with one job, too.
    """
    if jobs == 1 and not fresh:
        with threadpool_limits(1):
            for task in tasks:
                yield task, compute(task)
        return
    processes: set[SpawnProcess] = set()
    with ThreadPoolExecutor(jobs) as threads:
        futures = {threads.submit(_compute_apart, compute, task, processes): task for task in tasks}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
            for process in list(processes):
                process.kill()


def _compute_apart(compute: Callable[[_Task], _Outcome], task: _Task, processes: set[SpawnProcess]) -> _Outcome | Death:
    """The outcome from a new process, which is one of ``processes`` as long as it runs."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_run, args=(compute, task, theirs), daemon=True)
    process.start()
    processes.add(process)
    theirs.close()  # so that the death of the process ends the pipe
    try:
        outcome: _Outcome = ours.recv()
    except (EOFError, OSError):
        process.join()
        return Death(process.exitcode)
    finally:
        ours.close()
        process.join()
        processes.remove(process)
    return outcome


def _run(compute: Callable[[Any], Any], task: Any, connection: Connection[Any, Any]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["OMP_NUM_THREADS"] = "1"  # for libraries that are loaded later
    with threadpool_limits(1):
        connection.send(compute(task))


def _end_with_parent() -> None:
    """A parent that was killed cannot stop its processes."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
