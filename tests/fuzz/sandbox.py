"""Runs one command line in a child process with limits on time, memory and the size of files."""

import os
import resource
import signal
from dataclasses import dataclass
from pathlib import Path

from tests.helpers.forked_commands import ERR, OUT, start

SECONDS, MEMORY_BYTES, FILE_BYTES = 10, 1_500_000_000, 500_000_000


@dataclass(frozen=True)
class Outcome:
    """What became of it. ``code`` is negative for a signal; ``seconds`` are those of the processor; ``peak_bytes`` is
    beyond what the parent held.
    """

    code: int
    out: str
    err: str
    seconds: float
    peak_bytes: int


def run(arguments: list[str], folder: Path) -> Outcome:
    """``dslam`` with ``arguments``, from within ``folder``, as a fork of this process in which all is imported."""
    before = status_bytes("VmRSS")
    child = start(arguments, folder, _limit)
    _, status, usage = os.wait4(child, 0)
    return Outcome(
        code=os.waitstatus_to_exitcode(status),
        out=(folder / OUT).read_bytes().decode(errors="replace"),
        err=(folder / ERR).read_bytes().decode(errors="replace"),
        seconds=usage.ru_utime + usage.ru_stime,
        peak_bytes=max(usage.ru_maxrss * 1024 - before, 0),
    )


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_BYTES, FILE_BYTES))
    resource.setrlimit(resource.RLIMIT_AS, (status_bytes("VmSize") + MEMORY_BYTES,) * 2)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, 20.0 * SECONDS)  # for what waits; a shared machine is slow
    resource.setrlimit(resource.RLIMIT_CPU, (3 * SECONDS,) * 2)


def status_bytes(name: str) -> int:
    """Bytes that this process has, by its name in /proc/self/status."""
    with open("/proc/self/status", encoding="ascii") as stream:
        return next(int(line.split()[1]) * 1024 for line in stream if line.startswith(f"{name}:"))
