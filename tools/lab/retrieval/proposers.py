"""What proposes places in a map of objects: the index of a descriptor, as loop closing has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.registry import make_index
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.object_map.submap import Submap
from slam.place_recognition.landmark_pairs import Batch, VectorPairs
from slam.place_recognition.place_search import PlaceSearch
from tools.importers.maps import SURVEYED_SIGMA_M
from tools.lab.retrieval.labelled_map import LabelledMap


@dataclass(frozen=True, slots=True)
class Proposer:
    """An index of a map, of ``nbytes`` without the map, that proposes poses of queries in it.

    ``propose``: from a query to ``count`` poses (H, 4, 4) in the map at most, the likeliest first.
    """

    nbytes: int
    propose: Callable[[Submap, int], FloatArray]


def make_proposer(name: str, objects: LabelledMap) -> Proposer:
    """The index of a map by a descriptor, by its name in the registry.

    Raises:
        DescriptorError: a descriptor that does not exist.
    """
    index = make_index(name)
    pairs: PairIndex | VectorPairs
    if isinstance(index, PairIndex):
        pairs = index
        pairs.add(objects.positions, objects.labels)
    else:
        pairs, rows = VectorPairs(Config(), index), np.arange(len(objects))
        pairs.add(Batch(objects.positions, objects.labels, rows, rows, 0), objects.vocabulary)
    search = PlaceSearch(pairs, objects.positions, objects.labels, len(objects.vocabulary))

    def propose(query: Submap, count: int) -> FloatArray:
        return search.find_poses(query, map_sigma_m=SURVEYED_SIGMA_M, count=count)

    return Proposer(index.nbytes, propose)
