"""Where tasks are computed: by Ray, on this machine or a cluster, or by processes of this machine without it.

A task is a function of a module and an argument that can be pickled; what it makes it writes to files, so that a task
that is finished stays finished if the program dies.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

from slam.common.errors import FleetError
from slam.sweeps.workers import Death, compute_all

logger = logging.getLogger(__name__)

TRIES = 4
"""How often a task is begun whose process dies."""

_Task = TypeVar("_Task")
_Outcome = TypeVar("_Outcome")


class Engine(Protocol):
    """Computes tasks, in any order."""

    def compute(
        self, function: Callable[[_Task], _Outcome], tasks: Sequence[_Task]
    ) -> Iterator[tuple[_Task, _Outcome | Death]]:
        """Each task with its outcome, as they finish; with ``Death`` where its process died ``TRIES`` times."""
        ...


class ProcessEngine:
    """Processes of this machine, ``workers`` at a time."""

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def compute(
        self, function: Callable[[_Task], _Outcome], tasks: Sequence[_Task]
    ) -> Iterator[tuple[_Task, _Outcome | Death]]:
        """See :class:`Engine`."""
        waiting = list(tasks)
        for attempt in range(1, TRIES + 1):
            died = []
            for task, outcome in compute_all(function, waiting, jobs=self._workers, fresh=self._workers == 1):
                if isinstance(outcome, Death) and attempt < TRIES:
                    logger.info("a process died (exit code %s); its task is begun again", outcome.exit_code)
                    died.append(task)
                else:
                    yield task, outcome
            waiting = died
            if not waiting:
                return


class RayEngine:
    """Tasks of Ray; see :func:`open_engine`."""

    def __init__(self, ray: Any) -> None:
        self._ray = ray

    def compute(
        self, function: Callable[[_Task], _Outcome], tasks: Sequence[_Task]
    ) -> Iterator[tuple[_Task, _Outcome | Death]]:
        """See :class:`Engine`.

        Raises:
            FleetError: Ray itself failed, for example because its process on this machine died.
        """
        remote = self._ray.remote(num_cpus=1, max_retries=TRIES - 1)(function)
        running = {remote.remote(task): task for task in tasks}
        errors = self._ray.exceptions
        died = (errors.WorkerCrashedError, errors.OutOfMemoryError, errors.NodeDiedError)
        while running:
            finished, _ = self._ray.wait(list(running), num_returns=1)
            task = running.pop(finished[0])
            outcome: _Outcome | Death
            try:
                outcome = self._ray.get(finished[0])
            except died:
                outcome = Death(None)
            except errors.RayTaskError:
                raise  # the function raised it
            except errors.RayError as error:
                reason = (str(error) or type(error).__name__).splitlines()[0]
                raise FleetError(f"Ray failed: {reason} The same command continues from here.") from error
            yield task, outcome


@contextmanager
def open_engine(workers: int, *, address: str | None = None) -> Iterator[Engine]:
    """The engine for a fleet: Ray where it is installed, else processes.

    Args:
        workers: tasks at a time on this machine.
        address: of a Ray cluster that runs already.

    Raises:
        FleetError: an address without Ray, or at which no cluster answers.
    """
    if importlib.util.find_spec("ray") is None:
        if address is not None:
            raise FleetError(f"the cluster {address} needs Ray: pip install 'descriptellation-slam[fleet]'")
        logger.info("Ray is not installed; %d processes of this machine compute", workers)
        yield ProcessEngine(workers)
        return
    import ray

    try:
        ray.init(**_ray_options(workers, address))
    except Exception as error:  # Ray raises that itself where its processes do not come up
        where = f"at {address}" if address else "on this machine"
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise FleetError(f"Ray cannot be started {where}: {reason}") from error
    try:
        yield RayEngine(ray)
    finally:
        ray.shutdown()


def _ray_options(workers: int, address: str | None) -> dict[str, Any]:
    quiet = {"logging_level": logging.WARNING, "log_to_driver": False}
    return {"address": address, **quiet} if address else {"address": "local", "num_cpus": workers, **quiet}
