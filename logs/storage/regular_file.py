"""Opening files of a disk, and nothing else: a pipe may wait for ever, and a device never end."""

import errno
import os
import stat
from io import BufferedReader

AnyPath = str | os.PathLike[str]
MAX_BYTES = 1_000_000_000
"""Of a file that is read as a whole: a day of detections as a table."""


def open_regular(path: AnyPath) -> BufferedReader:
    """Open a file to read its bytes.

    Raises:
        OSError: it cannot be opened, or is a pipe, a device or a socket.
    """
    try:
        # Opening a pipe without a writer would block; the caller closes the stream.
        stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))  # noqa: SIM115
    except ValueError as error:  # a zero byte in the name
        raise OSError(errno.EINVAL, str(error), os.fspath(path)) from error
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise OSError(errno.EINVAL, "a pipe, a device or a socket; copy its content to a file", os.fspath(path))
    return stream


def read_regular(path: AnyPath) -> bytes:
    """The bytes of a file of at most ``MAX_BYTES``.

    Raises:
        OSError: it cannot be read, is larger, or is a pipe, a device or a socket.
    """
    with open_regular(path) as stream:
        if os.fstat(stream.fileno()).st_size > MAX_BYTES:
            raise OSError(errno.EFBIG, f"larger than {MAX_BYTES / 1e6:.0f} MB", os.fspath(path))
        return stream.read()
