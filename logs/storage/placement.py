"""Giving a finished file its name."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from logs.errors import UnwritableLogError
from logs.storage.regular_file import AnyPath

SPECIAL = "it is a device, a pipe or a socket, which a file would replace; give the name of a file"


def is_special(path: Path) -> bool:
    """Whether a device, a pipe or a socket has that name: an administrator could replace even these."""
    return path.exists() and not path.is_file() and not path.is_dir()


def check_replaceable(path: Path) -> None:
    """See that no folder, device, pipe or socket has the name of a file to be written.

    Raises:
        UnwritableLogError: one has.
    """
    if path.is_dir():
        raise UnwritableLogError(f"{path} is a folder; give the name of a file to write")
    if is_special(path):
        raise UnwritableLogError(f"cannot write {path}: {SPECIAL}")


def partial_path(path: Path) -> Path:
    """Where the file ``path`` is written until it is finished."""
    return path.with_name(f"{path.name}.part")


def put_in_place(part: Path, path: Path) -> None:
    """Rename ``part`` to ``path``, in the place of a file of that name.

    Raises:
        OSError: it cannot be renamed, or what has that name is no file.
    """
    if is_special(path):
        raise OSError(errno.EINVAL, SPECIAL)
    os.replace(part, path)


@contextmanager
def replacing(path: AnyPath) -> Iterator[Path]:
    """``NAME.part`` to be written, which takes the name at the end; after an error it is removed.

    Raises:
        UnwritableLogError: it cannot be written.
    """
    target = Path(path)
    part = partial_path(target)
    try:
        yield part
        put_in_place(part, target)
    except OSError as error:
        raise UnwritableLogError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            part.unlink()


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file, whole or not at all; halves of surrogate pairs, which UTF-8 has no place for, are escaped.

    Raises:
        UnwritableLogError: it cannot be written.
    """
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")
