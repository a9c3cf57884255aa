"""A descriptor of one's own: a class as ``module:Class``, from the current folder or an installed package."""

import importlib
import sys
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from descriptors.arrays import Float32Array
from descriptors.constellation import Constellations
from descriptors.errors import DescriptorError


def make_own(name: str) -> Any:
    """An object of a class, made without arguments.

    Raises:
        DescriptorError: it cannot be imported or made.
    """
    module, _, attribute = name.partition(":")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return getattr(importlib.import_module(module), attribute)()
    except Exception as error:  # user code raises anything
        raise DescriptorError(f"{name}: cannot be constructed: {type(error).__name__}: {error}") from error


class OwnDescriptor:
    """A class of one's own, whose vectors are checked."""

    def __init__(self, name: str) -> None:
        """Make the object.

        Raises:
            DescriptorError: it cannot be made, or is no descriptor.
        """
        self._class = name
        self._own = make_own(name)
        lacking = [part for part in ("name", "radius_m", "describe") if not hasattr(self._own, part)]
        if lacking:
            raise DescriptorError(
                f"{name}: is not a descriptor: it lacks {', '.join(lacking)}; see descriptors.descriptor.Descriptor"
            )
        self.name, radius_m = str(self._own.name), self._own.radius_m
        if not (isinstance(radius_m, Real) and 0.0 < float(radius_m) < np.inf):
            raise DescriptorError(f"{name}: radius_m is {radius_m!r}; give metres above 0")
        self.radius_m = float(radius_m)
        self._length: int | None = None

    def describe(self, constellations: Constellations) -> Float32Array:
        """Vectors (B, D).

        Raises:
            DescriptorError: it fails, or returns anything else, or numbers that are not finite.
        """
        try:
            vectors = np.asarray(self._own.describe(constellations), dtype=np.float32)
        except Exception as error:  # user code raises anything
            raise DescriptorError(f"{self._class}: describe fails: {type(error).__name__}: {error}") from error
        count = len(constellations)
        if vectors.ndim != 2 or len(vectors) != count or not vectors.shape[1]:
            raise DescriptorError(
                f"{self._class}: describe returns shape {vectors.shape} for {count} constellations; give ({count}, D)"
            )
        if self._length not in (None, vectors.shape[1]):
            raise DescriptorError(
                f"{self._class}: describe returns vectors of length {vectors.shape[1]}, before of length {self._length}"
            )
        is_finite = np.isfinite(vectors).all(axis=1)
        if not is_finite.all():
            raise DescriptorError(f"{self._class}: the vector of constellation {is_finite.argmin()} is not finite")
        self._length = vectors.shape[1]
        return vectors
