"""What a descriptor is."""

from typing import Protocol

from descriptors.arrays import Float32Array
from descriptors.constellation import Constellations


class Descriptor(Protocol):
    """Turns constellations into vectors that are near where constellations are alike.

    Its lengths are those for a sensor that sees 30 m; constellations of any other are scaled before it sees them.
    """

    @property
    def name(self) -> str:
        """Its name in the registry."""
        ...

    @property
    def radius_m(self) -> float:
        """How far neighbours count."""
        ...

    def describe(self, constellations: Constellations) -> Float32Array:
        """Vectors (B, D) of B constellations; D may depend on the size of the vocabulary alone."""
        ...
