"""What a descriptor is, and which there are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from descriptors.baselines.onion import OnionHistogram
from descriptors.constellation import Constellations
from descriptors.errors import DescriptorError
from descriptors.random_vector import RandomVector
from descriptors.ring_histogram import RingHistogram


class Descriptor(Protocol):
    """Turns constellations into vectors that are near where constellations are alike."""

    @property
    def name(self) -> str:
        """Its name in the registry."""
        ...

    @property
    def length(self) -> int:
        """How many numbers a vector has."""
        ...

    @property
    def radius_m(self) -> float:
        """How far neighbours count."""
        ...

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, length) of B constellations."""
        ...


_MAKERS: dict[str, Callable[[], Descriptor]] = {
    "ring_histogram": RingHistogram,
    "onion_histogram": OnionHistogram,
    "random": RandomVector,
}
DESCRIPTOR_NAMES = tuple(_MAKERS)


def make_descriptor(name: str) -> Descriptor:
    """The descriptor of that name, with its default parameters.

    Raises:
        DescriptorError: there is none of that name.
    """
    if name not in _MAKERS:
        raise DescriptorError(f"no descriptor {name!r}; there are {', '.join(_MAKERS)}")
    return _MAKERS[name]()
