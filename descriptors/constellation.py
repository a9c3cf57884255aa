"""Constellations: an object and its neighbours, many of them in one batch."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from descriptors.arrays import FloatArray, IntArray, frozen
from descriptors.errors import DescriptorError


@frozen
class Constellations:
    """B constellations in compressed rows: neighbours ``offsets[i]`` to ``offsets[i + 1]`` are those of the i-th.

    ``positions`` (P, 3) m: neighbours relative to their centre, axes gravity-aligned, the centre itself left out.
    ``labels`` (P,) and ``centre_labels`` (B,): places in ``vocabulary``. ``offsets`` (B + 1,).
    """

    positions: FloatArray
    labels: IntArray
    centre_labels: IntArray
    offsets: IntArray
    vocabulary: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.centre_labels)

    def __getitem__(self, rows: IntArray) -> "Constellations":
        """Those of the given numbers (K,), in that order."""
        counts = np.diff(self.offsets)[rows]
        offsets = np.concatenate([[0], np.cumsum(counts)])
        neighbours = np.arange(offsets[-1]) + np.repeat(self.offsets[rows] - offsets[:-1], counts)
        return Constellations(
            self.positions[neighbours], self.labels[neighbours], self.centre_labels[rows], offsets, self.vocabulary
        )

    @property
    def owners(self) -> IntArray:
        """Which constellation (P,) each neighbour belongs to."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))


def gather_constellations(
    positions: FloatArray,
    labels: IntArray,
    vocabulary: Sequence[str],
    *,
    radius_m: float,
    centres: IntArray | None = None,
) -> Constellations:
    """The constellation around each object: all others within ``radius_m`` of horizontal distance.

    Horizontal, because ground and kerbs move heights more than places. This is the paper's constellation extraction
    (Descriptellation, Section III-A), its visual range being ``radius_m``.

    Args:
        positions: (N, 3) m, gravity-aligned.
        labels: (N,) places in ``vocabulary``.
        centres: which objects (B,) to describe; all by default.

    Raises:
        DescriptorError: positions that are not finite.
    """
    is_finite = np.isfinite(positions).all(axis=1)
    if not is_finite.all():
        bad = int(is_finite.argmin())
        raise DescriptorError(f"object {bad} is at {positions[bad]}, which is not finite")
    chosen = np.arange(len(positions)) if centres is None else centres
    plane = cKDTree(positions[:, :2])
    near = cKDTree(positions[chosen, :2]).sparse_distance_matrix(plane, radius_m, output_type="ndarray")
    near = near[np.lexsort((near["j"], near["i"]))]
    near = near[near["j"] != chosen[near["i"]]]
    owners, neighbours = near["i"], near["j"]
    return Constellations(
        positions[neighbours] - positions[chosen[owners]],
        labels[neighbours],
        labels[chosen],
        np.searchsorted(owners, np.arange(len(chosen) + 1)),
        tuple(vocabulary),
    )
