"""Points that a file tells as lines of numbers."""

from __future__ import annotations

import warnings
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray


def read_rows(stream: BinaryIO, count: int, width: int) -> NDArray[Any]:
    """At most ``count`` rows (R, W) from here on; (0, ``width``) if there are to be none.

    Raises:
        ValueError: a line holds no numbers, or another number of them.
    """
    if count == 0:
        return np.zeros((0, width))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of lines without numbers
        return np.loadtxt(stream, max_rows=count, ndmin=2)
