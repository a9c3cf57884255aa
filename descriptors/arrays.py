"""The array types that signatures name, and classes of arrays; shapes, units and frames stand in the docstrings."""

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
UintArray = NDArray[np.uint32]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]

_T = TypeVar("_T")


@dataclass_transform(frozen_default=True, eq_default=False)
def frozen(data: type[_T]) -> type[_T]:
    """A dataclass that nothing changes; two are equal only if they are one, as arrays compare by their elements."""
    return dataclass(frozen=True, slots=True, eq=False)(data)
