"""Runs one command line in a child process with limits on time, memory and the size of files."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sys
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from tools import cli

CRASHED = 99
"""Exit code of a child whose error passed by the command line."""


@dataclass(frozen=True)
class Limits:
    seconds: int = 10
    memory_bytes: int = 1_500_000_000
    file_bytes: int = 500_000_000


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


def run(arguments: list[str], folder: Path, limits: Limits) -> Outcome:
    """``dslam`` with ``arguments``, from within ``folder``, as a fork of this process in which all is imported."""
    out, err = folder / "stdout.txt", folder / "stderr.txt"
    before = _pages("VmRSS")
    child = os.fork()
    if child == 0:
        _be_the_child(arguments, folder, out, err, limits)
    _, status, usage = os.wait4(child, 0)
    return Outcome(
        code=os.waitstatus_to_exitcode(status),
        out=out.read_bytes().decode(errors="replace"),
        err=err.read_bytes().decode(errors="replace"),
        seconds=usage.ru_utime + usage.ru_stime,
        peak_bytes=max(usage.ru_maxrss * 1024 - before, 0),
    )


def _be_the_child(arguments: list[str], folder: Path, out: Path, err: Path, limits: Limits) -> NoReturn:
    code = CRASHED
    try:
        os.chdir(folder)
        for number, path in ((0, os.devnull), (1, out), (2, err)):
            os.dup2(os.open(path, os.O_RDONLY if number == 0 else os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115  for as long as the child lives
        sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_bytes, limits.file_bytes))
        bytes_now = _pages("VmSize")
        resource.setrlimit(resource.RLIMIT_AS, (bytes_now + limits.memory_bytes,) * 2)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, 20.0 * limits.seconds)  # for what waits; a shared machine is slow
        resource.setrlimit(resource.RLIMIT_CPU, (3 * limits.seconds,) * 2)
        warnings.simplefilter("ignore", RuntimeWarning)  # as ``tools.main`` does
        code = cli.run(arguments)
    except BaseException:
        traceback.print_exc()
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def _pages(name: str) -> int:
    """Bytes that this process has, by its name in /proc/self/status."""
    with open("/proc/self/status", encoding="ascii") as stream:
        return next(int(line.split()[1]) * 1024 for line in stream if line.startswith(f"{name}:"))
