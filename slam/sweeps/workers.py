"""Tasks in processes of their own: one that dies takes only its task along, and none outlives its parent."""

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from threadpoolctl import threadpool_limits

_Task = TypeVar("_Task")
_Outcome = TypeVar("_Outcome")


DIED = "the process ended without a result; check the memory, try fewer jobs"


def compute_all(
    compute: Callable[[_Task], _Outcome], tasks: Sequence[_Task], *, jobs: int
) -> Generator[tuple[_Task, _Outcome | None], None, None]:
    """Each task with its outcome, None where its process died, as they finish.

    If the generator is closed, tasks that wait are not begun.

    Args:
        compute: a function of a module, which raises nothing; it runs on one thread.
        tasks: that can be pickled.
        jobs: tasks at a time, each in a new process.
    """
    with ThreadPoolExecutor(jobs) as threads:
        futures = {threads.submit(_compute_apart, compute, task): task for task in tasks}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            threads.shutdown(cancel_futures=True)


def _compute_apart(compute: Callable[[_Task], _Outcome], task: _Task) -> _Outcome | None:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _prepare) as process:
        try:
            return process.submit(compute, task).result()
        except BrokenProcessPool:
            return None


def _prepare() -> None:
    """Let the process end silently with Ctrl-C and with its parent, log nothing, and compute on one thread.

    Each task of a log would repeat its warnings, and a message may hold characters that control a terminal.
    """
    logging.disable()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["OMP_NUM_THREADS"] = "1"  # for libraries that are loaded later
    threadpool_limits(1)


def _end_with_parent() -> None:
    """A parent that was killed cannot stop its processes."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
