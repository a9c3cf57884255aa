"""Constellations padded to one size, as networks take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import Constellations


@dataclass(frozen=True, slots=True, eq=False)
class PaddedConstellations:
    """B constellations with room for N objects each, the centre first.

    ``positions`` (B, N, 3) float32 m relative to the centre, 0 where nothing is. ``labels`` (B, N) int64, 0 where
    nothing is. ``present`` (B, N) bool: where an object is; always so for the centre.
    """

    positions: NDArray[np.float32]
    labels: NDArray[np.int64]
    present: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.labels)

    def __getitem__(self, rows: slice | NDArray[np.int64]) -> PaddedConstellations:
        """Some of them, with no more room than they need."""
        present = self.present[rows]
        size = int(np.flatnonzero(present.any(axis=0)).max(initial=0)) + 1
        return PaddedConstellations(self.positions[rows, :size], self.labels[rows, :size], present[:, :size])


def pad_constellations(constellations: Constellations) -> PaddedConstellations:
    """The same constellations with their centres at the origin and in the first place."""
    counts = np.diff(constellations.offsets)
    shape = (len(constellations), int(counts.max(initial=0)) + 1)
    positions = np.zeros((*shape, 3), dtype=np.float32)
    labels = np.zeros(shape, dtype=np.int64)
    places = np.arange(shape[1])
    present = places <= counts[:, None]
    others = present & (places > 0)
    positions[others] = constellations.positions
    labels[others] = constellations.labels
    labels[:, 0] = constellations.centre_labels
    return PaddedConstellations(positions, labels, present)
