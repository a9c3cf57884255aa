"""Pairs of landmarks that a robot has left behind: which of them pairs of a query may be, by a descriptor."""

import numpy as np
from scipy.spatial.distance import pdist

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr.likelihood import LearnedLikelihood
from descriptors.descriptellation_lr.pair_index import PairIndex, PairMatches
from descriptors.descriptellation_lr.pairs import length_tolerances, spacing_m
from descriptors.index import VectorIndex
from descriptors.registry import make_index
from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config


@frozen
class Batch:
    """Landmarks that are added at once, and those around them: ``positions`` (N, 3) m and ``labels`` (N,) of both, in
    the odometry frame of the ``segment``; ``centres`` (C,): rows of the new ones; ``entries`` (N,): numbers of all in
    the index, -1 of those that it does not have; ``vocabulary``: the classes.
    """

    positions: FloatArray
    labels: IntArray
    centres: IntArray
    entries: IntArray
    segment: int
    vocabulary: tuple[str, ...]


class LearnedPairs(PairIndex):
    """Pairs by their learned likelihood ratio."""

    def __init__(self, likelihood: LearnedLikelihood) -> None:
        super().__init__(likelihood)
        self._batches = list[Batch]()

    def enter(self, batch: Batch) -> None:
        """Add landmarks; all are indexed again if their spacing has changed by a quarter since they were."""
        self._batches.append(batch)
        is_first = len(self._batches) == 1
        unit_m = spacing_m(
            batch.positions if is_first else np.concatenate([each.positions[each.centres] for each in self._batches])
        )
        new = [batch]
        if self.unit_m is None or abs(np.log(unit_m / self.unit_m)) > np.log(1.25):
            self.restart(unit_m)
            new = self._batches
        for each in new:
            self.add(each.positions, each.labels, numbers=each.entries, centres=each.centres)


class VectorPairs:
    """Pairs of the nearest neighbours of objects, by vectors of their constellations."""

    def __init__(self, config: Config, index: VectorIndex) -> None:
        self._top_k, self._index = config.loop_closure.top_k, index
        # Descriptors are made for a sensor that sees 30 m.
        self._scale = 30.0 / config.sensor_range_m
        self._plane, self._segments = np.zeros((0, 2)), np.zeros(0, dtype=np.int64)
        self._vocabulary: tuple[str, ...] = ()

    @property
    def nbytes(self) -> int:
        """Memory of the vectors."""
        return self._index.nbytes

    def enter(self, batch: Batch) -> None:
        """Add landmarks."""
        self._vocabulary = batch.vocabulary
        self._index.add(self._constellations(batch.positions, batch.labels, batch.centres))
        self._plane = np.concatenate([self._plane, batch.positions[batch.centres, :2]])
        self._segments = np.concatenate([self._segments, np.full(len(batch.centres), batch.segment)])

    def search(
        self, positions: FloatArray, labels: IntArray, *, sigmas_m: FloatArray, allowed: BoolArray | None = None
    ) -> PairMatches:
        """Pairs of the thousand nearest matches of single objects, where their lengths agree."""
        allowed = np.ones(len(self._plane), dtype=np.bool_) if allowed is None else allowed
        matches = self._index.search(self._constellations(positions, labels), self._top_k, allowed)
        nearest = np.argsort(matches.distances, kind="stable")[:1000]
        queries, entries = matches.queries[nearest], matches.entries[nearest]
        tolerance_m = length_tolerances(np.asarray(np.median(sigmas_m)))
        lengths_m = pdist(positions[queries, :2])
        may_be = (lengths_m > tolerance_m) & (np.abs(pdist(self._plane[entries]) - lengths_m) <= tolerance_m)
        pairs = np.column_stack(np.triu_indices(len(nearest), 1))[may_be]
        pairs = pairs[self._segments[entries[pairs[:, 0]]] == self._segments[entries[pairs[:, 1]]]]
        return PairMatches(queries[pairs], entries[pairs], np.ones(len(pairs)))

    def _constellations(
        self, positions: FloatArray, labels: IntArray, centres: IntArray | None = None
    ) -> Constellations:
        """Constellations of objects (N, 3) m, scaled to a sensor that sees as far as the descriptors are made for."""
        return gather_constellations(
            positions * self._scale, labels, self._vocabulary, radius_m=self._index.radius_m, centres=centres
        )


LandmarkPairs = LearnedPairs | VectorPairs


def make_landmark_pairs(config: Config) -> LandmarkPairs:
    """Pairs by the descriptor of the settings.

    Raises:
        DescriptorError: there is none of that name.
    """
    index = make_index(config.loop_closure.descriptor)
    return LearnedPairs(index.likelihood) if isinstance(index, PairIndex) else VectorPairs(config, index)
