"""Commands that are run in many forks of one process, in which all that they need is imported already."""

import contextlib
import os
import pkgutil
import sys
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

from tests.tools.runs import ROOT
from tools import cli

PACKAGES = ("descriptors", "logs", "slam", "tools")

CRASHED = 99
"""Exit code of a child whose error passed by the command line."""
OUT, ERR = "stdout.txt", "stderr.txt"
"""What a child has printed, in its folder."""

SCRATCH = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Where files are made: outputs are flushed to the disk before they get their names, which takes longer than the rest
of most commands."""


def import_commands() -> None:
    """Import what the commands import when they are called, as far as it is installed."""
    ours = [each.name for name in PACKAGES for each in pkgutil.walk_packages([str(ROOT / name)], f"{name}.")]
    for module in (*ours, "osmium", "multiprocessing.pool", "encodings.idna", "_strptime"):
        with contextlib.suppress(ImportError, OSError):
            __import__(module)
    cli.make_app()


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Put ``files``, "FOLDER/NAME" or NAME and what they hold, into ``folder``."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def start(arguments: Sequence[str], folder: Path, limit: Callable[[], None] = lambda: None) -> int:
    """``dslam`` with ``arguments``, from within ``folder``, in a child of this process; ``limit`` is called there.

    Returns:
        The number of the child, which the caller waits for.
    """
    child = os.fork()
    if child == 0:
        _be_the_child(list(arguments), folder, limit)
    return child


def _be_the_child(arguments: list[str], folder: Path, limit: Callable[[], None]) -> NoReturn:
    code = CRASHED
    try:
        os.chdir(folder)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for number, name in ((1, OUT), (2, ERR)):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115  for as long as the child lives
        sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
        limit()
        warnings.simplefilter("ignore", RuntimeWarning)  # as ``tools.main`` does
        code = cli.run(arguments)
    except BaseException:
        traceback.print_exc()
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)
