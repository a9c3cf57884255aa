"""Whether a file is as long as its header says, before memory is taken for what it says."""

from __future__ import annotations

import os
from typing import BinaryIO


def check_size(stream: BinaryIO, count: int, least_bytes: int, what: str) -> None:
    """There is room for ``count`` of ``what`` of ``least_bytes`` from here to the end; the last byte may be left out.

    Raises:
        ValueError: there is not; says how many there can be.
    """
    left = os.fstat(stream.fileno()).st_size - stream.tell() + 1
    if count * least_bytes > left:
        raise ValueError(f"at most {left // least_bytes} of {count} {what} are there; it is cut off")
