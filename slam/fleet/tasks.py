"""Tasks of a fleet in processes of this machine.

A task is a function of a module and an argument that can be pickled; its results are files, so that a finished task
stays finished if the program dies.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from slam.sweeps.workers import Death, compute_all

logger = logging.getLogger(__name__)

TRIES = 4
"""A task whose process dies is started so often."""

Compute = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[Any, Any]]]
"""Computes a function of each task; yields the tasks with their outcomes as they finish, ``Death`` where it failed."""


def compute_in_processes(
    function: Callable[[Any], Any], tasks: Sequence[Any], *, workers: int
) -> Iterator[tuple[Any, Any]]:
    """Each task with its outcome, as they finish; with ``Death`` where its process died ``TRIES`` times.

    Args:
        function: computes a task.
        tasks: each in a process of its own.
        workers: processes at a time.
    """
    waiting = list(tasks)
    for attempt in range(1, TRIES + 1):
        died = []
        for task, outcome in compute_all(function, waiting, jobs=workers, fresh=True):
            if isinstance(outcome, Death) and attempt < TRIES:
                logger.info("a process died (exit code %s); its task is started again", outcome.exit_code)
                died.append(task)
            else:
                yield task, outcome
        waiting = died
