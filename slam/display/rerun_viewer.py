"""Rerun's viewer as a separate process that listens on the loopback interface."""

from __future__ import annotations

import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from slam.common.errors import ViewerError

LOOPBACK = "127.0.0.1"
START_TIMEOUT_S = 60.0
_POLL_S = 0.1


def start_viewer(options: Sequence[str] = ()) -> tuple[subprocess.Popen[bytes], str]:
    """Start the viewer; returns its process, and the address to send recordings to.

    Raises:
        ViewerError: it ended at once, or does not answer.
    """
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        port = free.getsockname()[1]
    command = [_executable(), "--bind", LOOPBACK, "--port", str(port), "--expect-data-soon"]
    said = tempfile.TemporaryFile()  # noqa: SIM115  the viewer writes to it as long as it runs
    viewer = subprocess.Popen([*command, "--hide-welcome-screen", *options], stdout=said, stderr=said)
    deadline = time.monotonic() + START_TIMEOUT_S
    while not _answers(port):
        if viewer.poll() is not None:
            said.seek(0)
            lines = said.read().decode(errors="replace").split("\n")
            raise ViewerError(
                f"Rerun's viewer ended with code {viewer.returncode} ({' '.join(lines[-2:]).strip()}); "
                "it needs a display and a graphics driver: --save FILE.rrd writes what it would show"
            )
        if time.monotonic() > deadline:
            viewer.kill()
            raise ViewerError(f"Rerun's viewer did not answer on {LOOPBACK}:{port} within {START_TIMEOUT_S:.0f} s")
        time.sleep(_POLL_S)
    return viewer, f"rerun+http://{LOOPBACK}:{port}/proxy"


def _executable() -> str:
    """The viewer itself, not the script that starts it: to end that would leave the viewer behind."""
    import rerun_cli

    found = shutil.which("rerun", path=str(Path(rerun_cli.__file__).parent))
    if found is None:
        raise ViewerError("the installed Rerun has no viewer; install rerun-sdk from its wheel")
    return found


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((LOOPBACK, port)) == 0
