"""The command line: parse, call one library function, print. Here is the process around it.

A terminal is not always one: streams may be closed, full, or of an encoding without umlauts; and whoever interrupts or
ends the process gets one line, also while modules are imported.
"""

import os
import signal
import sys
import warnings
from types import FrameType

_STOPPING = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class Stopped(BaseException):
    """A signal asked the process to end; ``code`` is its exit code."""

    def __init__(self, number: int) -> None:
        super().__init__(_STOPPING[signal.Signals(number)])
        self.code = 128 + number


def main() -> None:
    """Entry point of ``dslam``."""
    for number in _STOPPING:
        signal.signal(number, _stop)
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `dslam info LOG | head` ends quietly
    warnings.simplefilter("ignore", RuntimeWarning)  # of libraries about numbers, which are checked where they matter
    _prepare_streams()
    try:
        from tools import cli

        code = cli.run(sys.argv[1:])
    except Stopped as error:
        code = error.code
        print("; ".join([f"dslam: {error}", *getattr(error, "__notes__", [])]), file=sys.stderr)
    _close_streams()
    sys.exit(code)


def _stop(number: int, frame: FrameType | None) -> None:
    for other in _STOPPING:
        signal.signal(other, signal.SIG_DFL)  # who asks again does not want to wait
    raise Stopped(number)


def _prepare_streams() -> None:
    """Streams that take any text: one that was closed is nowhere, and what it cannot show is written out."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  it stays open
        getattr(sys, name).reconfigure(errors="backslashreplace")


def _close_streams() -> None:
    """Write out what is left; where that fails it was told, and must not be told again when the process ends."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
