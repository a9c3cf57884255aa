"""An index of pairs of objects: which pairs of a map those of a query are, by the learned likelihood ratio.

Each pair of the map has a bit for each cell around it. The bits lie cell by cell, those of 64 pairs in a word, so that
one addition of words adds up what an observed object tells about 64 pairs (bit-sliced counters: O'Neil and Quass,
SIGMOD 1997). Many pairs that are added first are sorted by class and length: a pair of a query is compared only with
those that have its classes and its length.
"""

import mmap
from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from descriptors.arrays import BoolArray, Float32Array, FloatArray, IntArray, UintArray, frozen
from descriptors.descriptellation_lr.likelihood import LearnedLikelihood
from descriptors.descriptellation_lr.pairs import (
    QUERY_PARTNERS,
    cells_of,
    find_ends,
    gather_pairs,
    length_tolerances,
    spacing_m,
)

Words = NDArray[np.uint64]

MATCHES_PER_PAIR = 60
"""Likeliest pairs of the map for each pair of the query."""
STEP_NATS = 1.25
"""Of a counter: most observed objects are worth one to three steps."""
MAX_STEPS = 7
"""Most steps of an observed object."""
PAIRS_AT_ONCE = 4096
"""Pairs whose bits are computed, or that are compared with all pairs of a query, at a time."""
WORD = 64
FILLER = np.uint32(0xFFFFFFFF)
"""Classes of what fills the last word."""


@frozen
class PairMatches:
    """C pairs of the query that may be pairs of the map, the likeliest first: ``queries`` (C, 2) rows of the query,
    ``entries`` (C, 2) numbers of objects of the map, ``nats`` (C,) their log-likelihood ratios.
    """

    queries: IntArray
    entries: IntArray
    nats: NDArray[np.floating]


class PairIndex:
    """Pairs of a map that may grow.

    ``unit_m``: length of a spacing; that of the objects that are added first if None.
    """

    def __init__(self, likelihood: LearnedLikelihood, unit_m: float | None = None) -> None:
        self.likelihood = likelihood
        self.restart(unit_m)

    def restart(self, unit_m: float | None) -> None:
        """Forget all pairs; lengths of further ones are in another length of a spacing."""
        self.unit_m = unit_m
        self.words: Words = np.zeros((self.likelihood.architecture.cells, 0), dtype=np.uint64)
        self.ends = np.zeros((0, 2), dtype=np.uint32)
        self.lengths = np.zeros(0, dtype=np.float32)
        self.classes = np.zeros(0, dtype=np.uint32)
        self._sorted = 0

    @classmethod
    def of(
        cls,
        likelihood: LearnedLikelihood,
        unit_m: float,
        words: Words,
        ends: UintArray,
        lengths: Float32Array,
        classes: UintArray,
    ) -> "PairIndex":
        """The index with the arrays of one that was made at once.

        Raises:
            ValueError: arrays that do not fit together.
        """
        filled = words.shape[1] * WORD
        if words.shape[0] != likelihood.architecture.cells or not len(ends) == len(lengths) == len(classes) == filled:
            raise ValueError("its index of pairs is of another version")
        index = cls(likelihood, unit_m)
        index.words, index.ends, index.lengths, index.classes = words, ends, lengths, classes
        index._sorted = int(np.searchsorted(classes, FILLER))
        return index

    def __len__(self) -> int:
        return int(np.count_nonzero(self.classes != FILLER))

    @property
    def arrays(self) -> tuple[Words, UintArray, Float32Array, UintArray]:
        """What :meth:`of` makes it of again: the words, the ends, the lengths and the classes."""
        return self.words, self.ends, self.lengths, self.classes

    def read_ahead(self) -> None:
        """Read each page of an index that lies in a file once, so that no query waits for them."""
        for array in self.arrays:
            array.ravel()[:: mmap.PAGESIZE // array.itemsize].sum()

    @property
    def nbytes(self) -> int:
        """Memory of the pairs."""
        return sum(array.nbytes for array in self.arrays)

    def add(
        self,
        positions: FloatArray,
        labels: IntArray,
        *,
        numbers: IntArray | None = None,
        centres: IntArray | None = None,
    ) -> None:
        """Add the pairs of objects.

        Args:
            positions: (N, 2+) m.
            labels: (N,) classes.
            numbers: (N,) of the objects, in matches; their rows by default. Those of -1 are in no pair.
            centres: which objects (C,) are new; all by default. The others are only around them.
        """
        if self.unit_m is None:
            self.unit_m = spacing_m(positions)
        plane = positions[:, :2] / self.unit_m
        tree = cKDTree(plane)
        sizes = self.likelihood.architecture
        numbers = np.arange(len(plane)) if numbers is None else numbers
        ends = find_ends(plane, labels, tree, sizes.partners, centres=centres)
        ends = ends[(numbers[ends] >= 0).all(axis=1)]
        lengths = np.hypot(*(plane[ends[:, 1]] - plane[ends[:, 0]]).T)
        classes = _class_codes(labels[ends])
        order = np.lexsort((lengths, classes))
        ends, lengths, classes = ends[order], lengths[order], classes[order]
        blocks = []
        for start in range(0, len(ends), PAIRS_AT_ONCE):
            pairs = gather_pairs(plane, labels, ends[start : start + PAIRS_AT_ONCE], tree, sizes)
            blocks.append(_packed(self.likelihood.bits(pairs).T))
        if not len(self.ends) and len(ends) > PAIRS_AT_ONCE:
            self._sorted = len(ends)
        filler = -len(ends) % WORD
        self.words = np.concatenate([self.words, *blocks], axis=1)
        self.ends = np.concatenate([self.ends, numbers[ends], np.zeros((filler, 2))]).astype(np.uint32)
        self.lengths = np.concatenate([self.lengths, lengths, np.full(filler, np.inf)]).astype(np.float32)
        self.classes = np.concatenate([self.classes, classes, np.full(filler, FILLER)]).astype(np.uint32)

    def search(
        self, positions: FloatArray, labels: IntArray, *, sigmas_m: FloatArray, allowed: BoolArray | None = None
    ) -> PairMatches:
        """The likeliest pairs of the map for the pairs of a query.

        Args:
            positions: (N, 2+) m.
            labels: (N,) classes, numbered as in the map.
            sigmas_m: (N,) of a coordinate of each object, of query and map together.
            allowed: which objects of the map, by their number, may be matched; all by default.
        """
        none = np.zeros((0, 2), dtype=np.int64)
        found = [(none, none, np.zeros(0))]
        if self.unit_m is not None:
            asked = self._ask(positions[:, :2] / self.unit_m, labels, sigmas_m / self.unit_m)
            is_allowed = None if allowed is None else _packed(np.asarray(allowed[self.ends].all(axis=1))[None])[0]
            for rows, firsts, eligible in self._windows(asked):
                if is_allowed is not None:
                    eligible &= sliding_window_view(is_allowed, eligible.shape[1])[firsts]
                counters = _sum(self._columns(asked, rows, firsts, eligible.shape[1]), np.zeros_like(eligible))
                row, place, counts = _largest(counters, eligible, MATCHES_PER_PAIR)
                ends = self.ends[place + firsts[row] * WORD].astype(np.int64)
                found.append((asked.ends[rows[row]], ends, STEP_NATS * counts - asked.misses[rows[row]]))
        queries, entries, nats = (np.concatenate(parts) for parts in zip(*found, strict=True))
        best = np.argsort(-nats, kind="stable")[:3000]
        return PairMatches(queries[best], entries[best], nats[best])

    def _ask(self, plane: FloatArray, labels: IntArray, noise: FloatArray) -> "_Asked":
        """What the pairs of a query of objects at (N, 2) ask of the index, with a noise (N,) of each; in spacings."""
        tree = cKDTree(plane)
        ends = find_ends(plane, labels, tree, QUERY_PARTNERS, both_ways=True)
        pairs = gather_pairs(plane, labels, ends, tree, self.likelihood.architecture)
        # So many tell enough, those with most around them. The shortest are often of one object mapped twice.
        most = np.argsort(-pairs.counts, kind="stable")[:240]
        if len(most) < len(ends):
            pairs = gather_pairs(plane, labels, ends[np.sort(most)], tree, self.likelihood.architecture)
        sigmas = np.sqrt(np.mean(noise[pairs.ends] ** 2, axis=1))
        hits, misses = self.likelihood.worths(pairs, sigmas)
        cells, owners = cells_of(pairs, self.likelihood.architecture), pairs.owners
        inside = np.flatnonzero(cells >= 0)
        owners, cells = owners[inside], cells[inside]
        counts = np.bincount(owners, minlength=len(pairs))
        present = np.arange(counts.max(initial=0)) < counts[:, None]
        laid, steps = np.zeros((2, *present.shape), dtype=np.int64)
        laid[present] = cells
        steps[present] = np.clip(np.rint((hits + misses)[inside] / STEP_NATS), 1, MAX_STEPS)
        tolerances = length_tolerances(sigmas)
        return _Asked(
            pairs.ends,
            laid,
            steps,
            np.bincount(owners, weights=misses[inside], minlength=len(pairs)).astype(np.float64),
            _class_codes(labels[pairs.ends]),
            (pairs.lengths - tolerances).astype(np.float32),
            (pairs.lengths + tolerances).astype(np.float32),
        )

    def _windows(self, asked: "_Asked") -> Iterator[tuple[IntArray, IntArray, Words]]:
        """Where the pairs of the map may be that are of the classes and nearly of the length of those of the query.

        Rows (B,) of the query, the first word (B,) of each, and a mask (B, W) of the pairs from there on: of rows with
        nearly as many pairs that were added first, which are sorted, and of all rows for the others.
        """
        known = self.classes[: self._sorted]
        bounds = np.array([known.searchsorted(asked.classes, side=side) for side in ("left", "right")]).T
        for row, (begin, end) in enumerate(bounds.tolist()):
            bounds[row] = begin + self.lengths[begin:end].searchsorted([asked.low[row], asked.high[row]])
        words = -(-bounds[:, 1] // WORD) - bounds[:, 0] // WORD
        rows = np.flatnonzero(bounds[:, 1] > bounds[:, 0])
        rows = rows[np.argsort(words[rows], kind="stable")]
        while len(rows):
            # So many words of the map are what a cache of a core holds.
            batch = rows[: max(int(np.count_nonzero(np.cumsum(words[rows]) <= 8192)), 1)]
            rows, width = rows[len(batch) :], int(words[batch[-1]])
            firsts = np.minimum(bounds[batch, 0] // WORD, self.words.shape[1] - width)
            yield batch, firsts, _mask(bounds[batch] - firsts[:, None] * WORD, width)
        tail = -(-self._sorted // WORD)
        if len(asked.classes) and tail < self.words.shape[1]:
            of_tail = slice(tail * WORD, None)
            is_like = asked.classes[:, None] == self.classes[of_tail]
            is_like &= (asked.low[:, None] <= self.lengths[of_tail]) & (self.lengths[of_tail] <= asked.high[:, None])
            yield np.arange(len(asked.classes)), np.full(len(asked.classes), tail), _packed(is_like)

    def _columns(self, asked: "_Asked", rows: IntArray, firsts: IntArray, width: int) -> list[list[Words]]:
        """Words (B, W) of the cells that rows of the query ask for, by the bits of their steps."""
        windows = sliding_window_view(self.words, width, axis=1)
        levels = []
        for bit in range(MAX_STEPS.bit_length()):
            has_bit = ((asked.steps[rows] >> bit) & 1 > 0).T
            places = np.argsort(~has_bit, axis=0, kind="stable")[: has_bit.sum(axis=0).max()]
            words = windows[np.take_along_axis(asked.cells[rows].T, places, axis=0), firsts]
            words[~np.take_along_axis(has_bit, places, axis=0)] = 0
            levels.append(list(words))
        return levels


@frozen
class _Asked:
    """What P pairs of a query, ``ends`` (P, 2), ask: ``cells`` (P, K) of their neighbours and their ``steps`` (P, K), 0
    of none; ``misses`` (P,): nats that all of them take; ``classes`` (P,), and the least and greatest lengths ``low``
    and ``high`` (P,) of what they may be.
    """

    ends: IntArray
    cells: IntArray
    steps: IntArray
    misses: FloatArray
    classes: UintArray
    low: Float32Array
    high: Float32Array


def _class_codes(labels: IntArray) -> UintArray:
    """Both classes (P, 2) of pairs in one number (P,)."""
    return ((labels[:, 0] << 16) + (labels[:, 1] & 0xFFFF)).astype(np.uint32)


def _mask(bounds: IntArray, width: int) -> Words:
    """Words (B, W) in which the bits from the first of ``bounds`` (B, 2) to the second are set."""
    before = (bounds[:, :, None] - WORD * np.arange(width)).clip(0, WORD)  # bits of each word before either bound
    begins, ends = np.moveaxis(~np.uint64(0) << before.astype(np.uint64), 1, 0)  # a shift by a whole word gives 0
    return begins & ~ends


def _packed(bits: BoolArray) -> Words:
    """Bits (B, P) as words (B, ceil(P / 64))."""
    filled = np.zeros((len(bits), -(-bits.shape[1] // WORD) * WORD), dtype=np.bool_)
    filled[:, : bits.shape[1]] = bits
    return np.packbits(filled, axis=1, bitorder="little").view(np.uint64)


def _sum(levels: list[list[Words]], empty: Words) -> list[Words]:
    """Sums of words of the shape of ``empty`` by carry-save adders: counters bit by bit.

    ``levels``: words that count 1, 2 and 4, which are written to; ``empty``: words without a bit.
    """
    waiting, counters = [list(level) for level in levels], list[Words]()
    while waiting:
        level, carried = waiting.pop(0), list[Words]()
        while len(level) > 2:
            a, b, c = level.pop(), level.pop(), level.pop()
            either = a ^ b
            a &= b
            np.bitwise_xor(either, c, out=b)
            either &= c
            a |= either
            level.insert(0, b)
            carried.append(a)
        if len(level) == 2:
            carried.append(level[0] & level[1])
            level = [level[0] ^ level[1]]
        counters.append(level[0] if level else empty)
        if carried:
            waiting[:1] = [carried + waiting[0]] if waiting else [carried]
    return counters


def _largest(counters: list[Words], eligible: Words, count: int) -> tuple[IntArray, IntArray, IntArray]:
    """Row, place and value (C,) each of the ``count`` largest counters (B, W) of each row among those that are
    ``eligible`` (B, W), and of ties at the end as long as they are not too many.
    """
    above, equal = np.zeros_like(eligible), eligible
    wanted = np.full(len(eligible), count)
    for counter in reversed(counters):
        both = equal & counter
        ones = _ones(both)
        is_enough = ones > wanted
        unless_enough = np.where(is_enough, np.uint64(0), ~np.uint64(0))[:, None]
        equal = equal & (counter ^ unless_enough)
        both &= unless_enough
        above |= both
        wanted -= np.where(is_enough, 0, ones)
    chosen = above | equal
    for crowded in np.flatnonzero(_ones(equal) > wanted + count).tolist():
        first_words = np.where(np.cumsum(chosen[crowded] != 0) <= count, chosen[crowded], np.uint64(0))
        chosen[crowded] = above[crowded] if above[crowded].any() else first_words
    row, word = np.nonzero(chosen)
    bits = np.unpackbits(chosen[row, word].view(np.uint8).reshape(-1, 8), axis=1, bitorder="little")
    which, bit = np.nonzero(bits)
    row, word = row[which], word[which]
    values = np.zeros(len(row), dtype=np.int64)
    for place, counter in enumerate(counters):
        values += ((counter[row, word] >> bit.astype(np.uint64)) & np.uint64(1)).astype(np.int64) << place
    return row, word * WORD + bit, values


def _ones(words: Words) -> IntArray:
    """How many bits of each row (B, W) are set."""
    return np.asarray(np.bitwise_count(words).sum(axis=1, dtype=np.int64))
