"""What proposes places in a map of objects: the index of a descriptor, as loop closing has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.index import VectorIndex
from descriptors.registry import make_index
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.object_map.submap import Submap
from slam.place_recognition.landmark_index import Batch, LandmarkVectors
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
    return _by_pairs(index, objects) if isinstance(index, PairIndex) else _by_vectors(name, index, objects)


def _by_pairs(index: PairIndex, objects: LabelledMap) -> Proposer:
    """Searches the map as an imported one."""
    index.add(objects.positions, objects.labels)
    search = PlaceSearch(index, objects.positions, objects.labels, len(objects.vocabulary))

    def propose(query: Submap, count: int) -> FloatArray:
        return search.find_poses(query, map_sigma_m=SURVEYED_SIGMA_M, count=count)

    return Proposer(index.nbytes, propose)


def _by_vectors(name: str, index: VectorIndex, objects: LabelledMap) -> Proposer:
    """Registers the nearest neighbours of each object, as loop closing does."""
    config = Config().calibrated({"objects.landmark_sigma_m": SURVEYED_SIGMA_M})
    closing = config.loop_closure.model_copy(update={"descriptor": name})
    landmarks = LandmarkVectors(config.model_copy(update={"loop_closure": closing}), index)
    rows = np.arange(len(objects))
    landmarks.add(Batch(objects.positions, objects.labels, rows, rows, 0), objects.vocabulary)
    everywhere = np.ones(len(objects), dtype=np.bool_)

    def propose(query: Submap, count: int) -> FloatArray:
        return np.array([T for T, _ in landmarks.propose(query, everywhere, count)]).reshape(-1, 4, 4)

    return Proposer(index.nbytes, propose)
