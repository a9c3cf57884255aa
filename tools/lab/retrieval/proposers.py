"""Proposers of places in a map of objects: a descriptor with its index, or the quads of imported maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
from tools.importers.maps import SURVEYED_SIGMA_M
from tools.lab.retrieval.labelled_map import LabelledMap

QUADS, VOTES = "quads", "quads without likelihood"
ADDED_AT_ONCE = 50_000
"""Objects whose neighbours are in memory at the same time."""


@dataclass(frozen=True, slots=True)
class Proposer:
    """An index of a map, of ``nbytes`` without the map, that proposes poses of queries in it.

    ``propose``: from a query to ``count`` poses (H, 4, 4) in the map at most, the likeliest first.
    """

    nbytes: int
    propose: Callable[[Submap, int], FloatArray]


def make_proposer(name: str, objects: LabelledMap) -> Proposer:
    """The index of a map: :data:`QUADS`, :data:`VOTES`, or a descriptor by its name in the registry.

    Raises:
        DescriptorError: a descriptor that does not exist.
    """
    if name in (QUADS, VOTES):
        return _propose_by_quads(objects, by_likelihood=name == QUADS)
    return _propose_by_descriptors(name, objects)


def _propose_by_descriptors(name: str, objects: LabelledMap) -> Proposer:
    """Matches each object of a query with its nearest descriptors, and registers the matches, as loop closing does."""
    index, config = make_index(name), Config()
    for start in range(0, len(objects), ADDED_AT_ONCE):
        centres = np.arange(start, min(start + ADDED_AT_ONCE, len(objects)))
        index.add(
            gather_constellations(
                objects.positions, objects.labels, objects.vocabulary, radius_m=index.radius_m, centres=centres
            )
        )

    def propose(query: Submap, count: int) -> FloatArray:
        asked = gather_constellations(query.positions, query.labels, objects.vocabulary, radius_m=index.radius_m)
        matches = index.search(asked, config.loop_closure.top_k, np.ones(len(index), dtype=np.bool_))
        if not len(matches.queries):
            return np.zeros((0, 4, 4))
        entries, references = np.unique(matches.entries, return_inverse=True)
        found = register(
            query.positions,
            objects.positions[entries],
            np.column_stack([matches.queries, references]),
            registration_config(config),
            query_sigmas=query.sigmas,
            reference_sigmas=np.full(len(entries), SURVEYED_SIGMA_M),
            count=count,
        )
        poses = [each.T_reference_query for each in found if each.T_reference_query is not None]
        return np.array(poses).reshape(-1, 4, 4)

    return Proposer(index.nbytes, propose)


def _propose_by_quads(objects: LabelledMap, *, by_likelihood: bool) -> Proposer:
    """Poses on which quads of the query and of the map agree: ``by_likelihood`` the likeliest first, as in imported
    maps, else those with most votes.
    """
    quads = build_quad_index(objects.positions, objects.labels, sigma_m=SURVEYED_SIGMA_M)
    search = MapSearch(quads, objects.positions, objects.labels, len(objects.vocabulary))

    def propose(query: Submap, count: int) -> FloatArray:
        sigma_m = float(np.hypot(np.median(query.sigmas), SURVEYED_SIGMA_M))
        if by_likelihood:
            return search.find_poses(query.positions, query.labels, sigma_m=sigma_m, count=count)
        return quads.find_poses(query.positions, query.labels, objects.positions, sigma_m=sigma_m, count=count)

    return Proposer(quads.vertices.nbytes + quads.starts.nbytes, propose)
