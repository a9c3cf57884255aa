"""Rerun's viewer as a separate process, which listens on the loopback interface."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from slam.common.errors import ViewerError

LOOPBACK = "127.0.0.1"


def show_recording(path: Path) -> None:
    """Show a recording until the window is closed.

    Raises:
        ViewerError: the viewer cannot be started.
    """
    command = [_executable(), "--bind", LOOPBACK, "--port", "auto", "--hide-welcome-screen", str(path)]
    viewer = subprocess.run(command, capture_output=True, check=False)
    if viewer.returncode:
        reason = " ".join(viewer.stderr.decode(errors="replace").split("\n")[-2:]).strip()
        raise ViewerError(
            f"Rerun's viewer ended with code {viewer.returncode} ({reason}); it needs a display and a graphics driver: "
            "--save FILE.rrd writes what it would show"
        )


def _executable() -> str:
    """The viewer itself, not the script that starts it: to end that would leave the viewer behind."""
    import rerun_cli

    found = shutil.which("rerun", path=str(Path(rerun_cli.__file__).parent))
    if found is None:
        raise ViewerError("the installed Rerun has no viewer; install rerun-sdk from its wheel")
    return found
