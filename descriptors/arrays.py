"""The array types that signatures name; shapes, units and frames stand in the docstrings."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
UintArray = NDArray[np.uint32]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]
