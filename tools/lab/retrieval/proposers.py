"""What proposes places in a map of objects: a descriptor with its index, or the quads of imported maps."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from descriptors.constellation import gather_constellations
from descriptors.registry import make_index
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.object_map.submap import Submap
from slam.place_recognition.map_search import MapSearch
from slam.place_recognition.quad_index import build_quad_index
from slam.registration.parameters import registration_config
from slam.registration.registration import register
from tools.lab.descriptors.queries import LabelledMap

QUADS, VOTES = "quads", "quads without likelihood"
MAP_SIGMA_M = 0.3
"""Standard deviation of a coordinate of an object of the map."""
ADDED_AT_ONCE = 50_000
"""Objects whose neighbours are in memory at the same time."""


class Proposer(Protocol):
    """An index of a map that proposes poses of queries in it."""

    @property
    def nbytes(self) -> int:
        """Memory of the index, without the map."""
        ...

    def propose(self, query: Submap, count: int) -> FloatArray:
        """Poses (H, 4, 4) of a query in the map, ``count`` at most, the likeliest first."""
        ...


def make_proposer(name: str, objects: LabelledMap) -> Proposer:
    """The index of a map: :data:`QUADS`, :data:`VOTES`, or a descriptor by its name in the registry.

    Raises:
        DescriptorError: a descriptor that does not exist.
    """
    if name in (QUADS, VOTES):
        return QuadProposer(objects, by_likelihood=name == QUADS)
    return DescriptorProposer(name, objects)


class DescriptorProposer:
    """Matches each object of a query with its nearest descriptors, and registers the matches, as loop closing does."""

    def __init__(self, name: str, objects: LabelledMap) -> None:
        self._objects = objects
        self._config = Config()
        self._index = make_index(name)
        for start in range(0, len(objects), ADDED_AT_ONCE):
            centres = np.arange(start, min(start + ADDED_AT_ONCE, len(objects)))
            self._index.add(
                gather_constellations(
                    objects.positions,
                    objects.labels,
                    objects.vocabulary,
                    radius_m=self._index.radius_m,
                    centres=centres,
                )
            )

    @property
    def nbytes(self) -> int:
        """Memory of the vectors."""
        return self._index.nbytes

    def propose(self, query: Submap, count: int) -> FloatArray:
        """Poses (H, 4, 4) on which most matches agree."""
        asked = gather_constellations(
            query.positions, query.labels, self._objects.vocabulary, radius_m=self._index.radius_m
        )
        everything = np.ones(len(self._index), dtype=np.bool_)
        matches = self._index.search(asked, self._config.loop_closure.top_k, everything)
        if not len(matches.queries):
            return np.zeros((0, 4, 4))
        entries, references = np.unique(matches.entries, return_inverse=True)
        found = register(
            query.positions,
            self._objects.positions[entries],
            np.column_stack([matches.queries, references]),
            registration_config(self._config),
            query_sigmas=query.sigmas,
            reference_sigmas=np.full(len(entries), MAP_SIGMA_M),
            count=count,
        )
        poses = [each.T_reference_query for each in found if each.T_reference_query is not None]
        return np.array(poses).reshape(-1, 4, 4)


class QuadProposer:
    """Poses on which quads of the query and of the map agree: ``by_likelihood`` the likeliest first, as in imported
    maps, else those with most votes.
    """

    def __init__(self, objects: LabelledMap, *, by_likelihood: bool) -> None:
        self._objects = objects
        self._quads = build_quad_index(objects.positions, objects.labels, sigma_m=MAP_SIGMA_M)
        self._search = MapSearch(self._quads, objects.positions, objects.labels, len(objects.vocabulary))
        self._by_likelihood = by_likelihood

    @property
    def nbytes(self) -> int:
        """Memory of the quads."""
        return self._quads.vertices.nbytes + self._quads.starts.nbytes

    def propose(self, query: Submap, count: int) -> FloatArray:
        """Poses (H, 4, 4), best first."""
        sigma_m = float(np.hypot(np.median(query.sigmas), MAP_SIGMA_M))
        positions, labels = query.positions, query.labels
        if self._by_likelihood:
            return self._search.find_poses(positions, labels, sigma_m=sigma_m, count=count)
        return self._quads.find_poses(positions, labels, self._objects.positions, sigma_m=sigma_m, count=count)
