"""Commands and programs of a user, run in the environment where the wheel is installed."""

import subprocess
from pathlib import Path


def run(home: Path, *command: object) -> str:
    """What a program of the environment ``home`` prints that ends well."""
    result = subprocess.run(
        [str(home / "bin" / str(command[0])), *map(str, command[1:])],
        cwd=home,
        env={"PYTHONPATH": str(home / "others"), "PATH": "/usr/bin:/bin", "HOME": str(home), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, f"{command}: {result.stderr[-2000:]}"
    return result.stdout
