"""Pairs of objects and the constellation around each, in the frame of the pair.

Two objects determine a frame: its origin is the middle of both, its x axis points from the first to the second. What
is around has a direction there, not only a distance, and still does not depend on the heading of a sensor. Lengths are
in spacings, the median distance of an object of the map to its nearest neighbour, so that streets, forests and halls
look alike.
"""

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated
from scipy.spatial import cKDTree

from descriptors.arrays import Float32Array, FloatArray, IntArray, frozen

FEATURES = 5
"""Numbers that :attr:`Pairs.features` gives for each neighbour."""
QUERY_FEATURES = 4
"""Numbers that :func:`query_features` gives for each observed neighbour."""
DENSITY = float(np.log(2.0) / np.pi)
"""Objects on a square spacing of a Poisson process: half of them have another one within a spacing."""
MIN_RADIUS = 0.05
"""Distance, in spacings, below which a neighbour is no nearer to the middle of a pair."""
MAX_SIGMA = 1.5
"""Widest angle [rad] of a kernel: a neighbour in the middle of a pair is in no direction."""
MAX_NEIGHBOURS = 32
"""Neighbours of a pair that count, the nearest: twice as many as the radius has on average."""
QUERY_PARTNERS = 5
"""Partners of each object of a query: more than in the map, as clutter stands between some of them."""
MIN_LENGTH = 0.1
"""Shortest pair, in spacings; a shorter one has no heading."""


@validated(frozen=True, slots=True, config=ConfigDict(extra="forbid"))
class DescriptellationLRArchitecture:
    """Sizes of the likelihood. Lengths are in spacings.

    ``rings`` between ``inner`` and ``outer``, each of ``sectors`` cells; ``partners``: each object of the map makes a
    pair with so many of its nearest neighbours; ``hidden``: units of the gate and of the worth.
    """

    name: str = "descriptellation_lr"
    inner: float = 0.25
    outer: float = 5.0
    rings: int = 30
    sectors: int = 32
    partners: int = 3
    hidden: int = 24

    @property
    def cells(self) -> int:
        """Cells around a pair."""
        return self.rings * self.sectors

    @property
    def edges(self) -> FloatArray:
        """Radii (R + 1,) of the rings."""
        return np.linspace(self.inner, self.outer, self.rings + 1)


@frozen
class Pairs:
    """P pairs of objects and their K neighbours.

    ``ends`` (P, 2) rows of the objects, the lower class first; ``lengths`` (P,) spacings; ``owners`` (K,), ascending:
    which pair each neighbour belongs to; ``radii`` (K,) spacings and ``angles`` (K,) rad of the neighbours in the frame
    of their pair, turned by their class; ``features`` (K, FEATURES): its distance, the length of the pair, how many
    neighbours there are, how many of its class, and how many of those are about as far away.
    """

    ends: IntArray
    lengths: FloatArray
    owners: IntArray
    radii: FloatArray
    angles: FloatArray
    features: Float32Array

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def counts(self) -> IntArray:
        """How many neighbours each pair (P,) has."""
        return np.bincount(self.owners, minlength=len(self))


def spacing_m(positions: FloatArray) -> float:
    """Median distance [m] of an object (N, 2+) to its nearest neighbour elsewhere; 1 if there are fewer than two."""
    distinct = np.unique(positions[:, 0] + 1j * positions[:, 1])  # much faster than by rows
    if len(distinct) < 2:
        return 1.0
    plane = np.column_stack([distinct.real, distinct.imag])
    return float(np.median(cKDTree(plane).query(plane, k=[2])[0]))


def find_ends(
    positions: FloatArray,
    labels: IntArray,
    tree: cKDTree,
    partners: int,
    *,
    centres: IntArray | None = None,
    both_ways: bool = False,
) -> IntArray:
    """Each object with its nearest neighbours, each pair once: rows (P, 2), the lower class first.

    Args:
        positions: (N, 2) spacings.
        labels: (N,) classes.
        tree: of the positions.
        partners: neighbours of each object.
        centres: which objects (C,) to look from; all by default.
        both_ways: pairs of one class in both directions, for a query does not know which one the map has.
    """
    rows = np.arange(len(positions)) if centres is None else centres
    near = np.asarray(tree.query(positions[rows], k=np.arange(1, partners + 2))[1], dtype=np.int64)
    pairs = np.column_stack([np.repeat(rows, partners + 1), near.ravel()])
    # Where there are fewer neighbours, the tree names one more object than there are.
    pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & (pairs[:, 1] < len(positions))]
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    is_turned = labels[pairs[:, 0]] > labels[pairs[:, 1]]
    pairs[is_turned] = pairs[is_turned, ::-1]
    if both_ways:
        pairs = np.concatenate([pairs, pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]], ::-1]])
    apart = positions[pairs[:, 1]] - positions[pairs[:, 0]]
    return pairs[np.einsum("ij,ij->i", apart, apart) > MIN_LENGTH**2]


def gather_pairs(
    positions: FloatArray, labels: IntArray, ends: IntArray, tree: cKDTree, architecture: DescriptellationLRArchitecture
) -> Pairs:
    """The constellations of pairs.

    Args:
        positions: (N, 2) spacings.
        labels: (N,) classes.
        ends: (P, 2) rows of both.
        tree: of the positions.
        architecture: which radii count.
    """
    plane = positions[:, 0] + 1j * positions[:, 1]
    first, second = plane[ends[:, 0]], plane[ends[:, 1]]
    lengths, middles = np.abs(second - first), 0.5 * (first + second)
    asked = np.column_stack([middles.real, middles.imag])
    distances, near = tree.query(asked, k=np.arange(1, MAX_NEIGHBOURS + 3), distance_upper_bound=architecture.outer)
    is_other = np.isfinite(distances) & (near != ends[:, :1]) & (near != ends[:, 1:])
    owners, rows = np.nonzero(is_other)[0], np.asarray(near)[is_other]
    local = (plane[rows] - middles[owners]) * ((second - first) / lengths)[owners].conj()
    radii, classes = np.abs(local), labels[rows]
    counts = np.bincount(owners, minlength=len(ends))[owners]
    keys = np.unique(owners * (classes.max(initial=0) + 1) + classes, return_inverse=True)[1]
    bands = keys * 64 + np.minimum(radii, 63.0).astype(np.int64)
    features = [
        np.log(np.maximum(radii, MIN_RADIUS)),
        np.log(lengths[owners]),
        np.log(counts) - 2.0,
        np.log(np.bincount(keys)[keys] / counts),
        np.log(np.bincount(bands)[bands]),
    ]
    # Each class is turned against the one before by the golden section: patterns of different classes then fall into
    # different cells, with as many bits as one class needs.
    turns = 2.0 * np.pi * 0.6180339887498949 * classes
    angles = np.angle(local * np.exp(1j * turns))
    return Pairs(ends, lengths, owners, radii, angles, np.column_stack(features).astype(np.float32))


def cells_of(pairs: Pairs, architecture: DescriptellationLRArchitecture) -> IntArray:
    """The cell (K,) of each neighbour; -1 inside the inner ring and outside the outer one."""
    rings = np.searchsorted(architecture.edges, pairs.radii, side="right") - 1
    turns = pairs.angles / (2.0 * np.pi) % 1.0
    sectors = np.floor(turns * architecture.sectors).astype(np.int64) % architecture.sectors
    is_inside = (rings >= 0) & (rings < architecture.rings)
    return np.where(is_inside, rings * architecture.sectors + sectors, -1)


def query_features(pairs: Pairs, sigmas: FloatArray) -> Float32Array:
    """Of each observed neighbour (K, 4): its distance, the length of the pair, the noise, and how many there are.

    Args:
        pairs: of the query.
        sigmas: (P,) standard deviation of a coordinate around each pair, of query and map together, in spacings.
    """
    noise = np.log(np.maximum(sigmas, 0.005))[pairs.owners] + 2.5
    return np.insert(pairs.features[:, :3], 2, noise, axis=1)


def length_tolerances(sigmas: FloatArray) -> FloatArray:
    """By how much (P,) the lengths of two pairs that are the same differ at most, in 95 of 100 pairs; a length has two
    noisy ends.
    """
    return 2.0 * np.sqrt(2.0) * sigmas
