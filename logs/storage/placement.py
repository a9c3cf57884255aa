"""Giving a finished file its name."""

from __future__ import annotations

import errno
import os
from pathlib import Path

SPECIAL = "it is a device, a pipe or a socket, which a file would replace; give the name of a file"


def is_special(path: Path) -> bool:
    """Whether a device, a pipe or a socket has that name: an administrator could replace even these."""
    return path.exists() and not path.is_file() and not path.is_dir()


def put_in_place(part: Path, path: Path) -> None:
    """Rename ``part`` to ``path``, in the place of a file of that name.

    Raises:
        OSError: it cannot be renamed, or what has that name is no file.
    """
    if is_special(path):
        raise OSError(errno.EINVAL, SPECIAL)
    os.replace(part, path)
