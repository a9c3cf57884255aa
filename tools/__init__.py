"""The command line: parse, call one library function, print. Here is the process around it.

A terminal is not always one: streams may be closed, full, or of an encoding without umlauts; and whoever interrupts or
ends the process gets one line, also while modules are imported.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import warnings
from types import FrameType

_STOPPING = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
_RAISE_AGAIN_S = 0.1


class Stopped(BaseException):
    """A signal asked the process to end; ``code`` is its exit code."""

    def __init__(self, number: int) -> None:
        super().__init__(_STOPPING[signal.Signals(number)])
        self.code = 128 + number


_stopped: Stopped | None = None


def stopped() -> Stopped | None:
    """The signal that ended the process, even if its exception was replaced by another error."""
    return _stopped


def main() -> None:
    """Entry point of ``dslam``."""
    for number in _STOPPING:
        signal.signal(number, _stop)
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `dslam info LOG | head` ends quietly
    warnings.simplefilter("ignore", RuntimeWarning)  # of libraries about numbers, which are checked where they matter
    code = 1
    try:
        _prepare_streams()
        from tools import cli

        code = cli.run(sys.argv[1:])
    except BaseException as error:
        _raise_again_every(0.0)
        if _stopped is None:
            raise
        code = _stopped.code
        notes = getattr(error, "__notes__", [])
        with contextlib.suppress(OSError):
            sys.stderr.write(f"dslam: {'; '.join([str(_stopped), *notes])}\n")
    _raise_again_every(0.0)
    for number in _STOPPING:
        signal.signal(number, signal.SIG_IGN)  # there is nothing left to interrupt
    _close_streams()
    sys.exit(code)


def _stop(number: int, frame: FrameType | None) -> None:
    global _stopped
    for other in _STOPPING:
        signal.signal(other, signal.SIG_DFL)  # who asks again does not want to wait
    _stopped = Stopped(number)
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, _stop_again)
    _raise_again_every(_RAISE_AGAIN_S)
    raise _stopped


def _stop_again(number: int, frame: FrameType | None) -> None:
    """Raise again what a library swallowed: numpy clears whatever is raised while it looks for protocols."""
    error = sys.exc_info()[1]
    while error is not None and error is not _stopped:
        error = error.__context__
    if error is None and _stopped is not None:  # else it is on its way, and files are being closed
        raise _stopped


def _raise_again_every(seconds: float) -> None:
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, seconds, seconds)


def _prepare_streams() -> None:
    """Streams that take any text: one that was closed is nowhere, and what it cannot show is written out."""
    for name, number in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_WRONLY)
            if descriptor != number:
                os.dup2(descriptor, number)
            setattr(sys, name, open(number, "w", encoding="utf-8", closefd=False))  # noqa: SIM115  it stays open
        getattr(sys, name).reconfigure(errors="backslashreplace")


def _close_streams() -> None:
    """Write out what is left; where that fails it was told, and must not be told again when the process ends."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
