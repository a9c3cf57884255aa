"""Checks that a saved map is consistent: names are unique and resolve, and its graph is connected."""

from collections import Counter
from collections.abc import Iterator
from itertools import chain

import numpy as np

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.backend.edge_kind import EdgeKind
from slam.common.arrays import IntArray, least_eigenvalues


def find_fault(objects: ObjectMapRecord, graph: FactorGraphRecord) -> str:
    """The first error of a map, in one line; empty for a valid map.

    Args:
        objects: its landmarks, all confirmed.
        graph: its keyframes, and what ties them and the landmarks together.
    """
    if not objects.ids or not len(graph.keyframe_ids):
        return "it has no landmarks or no keyframes, so no robot can be localized in it"
    fault = find_graph_fault(objects, graph)
    return fault or next(chain(_faults_of_objects(objects), _faults_of_connections(graph)), "")


def find_graph_fault(objects: ObjectMapRecord, graph: FactorGraphRecord) -> str:
    """The first error in the names and the noise of a graph of these landmarks, in one line; empty without one."""
    return next(chain(_faults_of_names(objects, graph), _faults_of_noise(graph)), "")


def parts(keyframes: IntArray, edges: IntArray) -> IntArray:
    """Number (K,) of the part to which each of the keyframes (K,) belongs, by the edges (E, 2) between them; parts are
    in the order of their first keyframes.
    """
    order = np.argsort(keyframes)
    ends = order[np.searchsorted(keyframes, edges.T, sorter=order)]
    part = np.arange(len(order))  # SciPy would take longer to load than a map to describe
    while (part[ends[0]] != part[ends[1]]).any():
        least = part[ends].min(axis=0)
        for end in ends:  # the parts of both ends are joined, so that a chain takes few rounds
            np.minimum.at(part, part[end], least)
        part = part[part]
    return np.unique(part, return_inverse=True)[1]


def _faults_of_names(objects: ObjectMapRecord, graph: FactorGraphRecord) -> Iterator[str]:
    keyframes = graph.keyframe_ids.tolist()
    named = {"landmark": objects.ids, "class": objects.vocabulary, "keyframe": keyframes}
    for what, names in named.items():
        yield from (f"{what} {name} is in it more than once" for name, count in Counter(names).items() if count > 1)
    yield from (f"the number of keyframe {keyframe} is negative" for keyframe in keyframes if keyframe < 0)
    used = {
        "an edge of its graph ends at keyframe": set(graph.edge_keyframe_ids.ravel().tolist()) - set(keyframes),
        "its graph observes from keyframe": set(graph.observation_keyframe_ids.tolist()) - set(keyframes),
        "its graph observes landmark": set(graph.observation_landmark_ids) - set(objects.ids),
    }
    for what, unknown in used.items():
        yield from (f"{what} {name}, which it does not have" for name in sorted(unknown))
    kinds = sorted(set(graph.edge_kinds) - set(EdgeKind))
    yield from (f"its graph has edges of an unknown kind {kind!r}" for kind in kinds)


def _faults_of_objects(objects: ObjectMapRecord) -> Iterator[str]:
    probabilities = objects.class_probabilities
    is_normalised = np.abs(probabilities.sum(axis=1) - 1.0) <= 1e-6  # rounding
    trace, least = np.trace(objects.covariances, axis1=1, axis2=2), least_eigenvalues(objects.covariances)
    faults = {
        "is not confirmed": ~objects.is_confirmed,
        "has a position that is not finite": ~np.isfinite(objects.positions).all(axis=1),
        "has a matrix that is not a covariance": ~((trace > 0.0) & (least >= -1e-6 * np.abs(trace))),
        "has class probabilities that do not sum to 1": ~is_normalised | (probabilities < 0.0).any(axis=1),
        "was never seen": objects.observation_counts < 1,
    }
    for what, wrong in faults.items():
        yield from (f"landmark {objects.ids[row]} {what}" for row in np.flatnonzero(wrong))


def _faults_of_noise(graph: FactorGraphRecord) -> Iterator[str]:
    for first, second in graph.edge_keyframe_ids[least_eigenvalues(graph.edge_covariances) <= 0.0]:
        yield f"edge {first} -> {second} of its graph has a covariance that is not positive definite"
    for row in np.flatnonzero(least_eigenvalues(graph.observation_covariances) <= 0.0):
        yield (
            f"its graph observes landmark {graph.observation_landmark_ids[row]} from keyframe "
            f"{graph.observation_keyframe_ids[row]} with a covariance that is not positive definite"
        )
    inflations = graph.observation_redundancies
    if len(inflations) and (len(inflations) != len(graph.observation_covariances) or (inflations <= 0.0).any()):
        yield "its graph has an observation without a positive covariance inflation"


def _faults_of_connections(graph: FactorGraphRecord) -> Iterator[str]:
    ends = graph.edge_keyframe_ids
    for keyframe, _ in ends[ends[:, 0] == ends[:, 1]]:
        yield f"an edge of its graph leads from keyframe {keyframe} to itself"
    part = parts(graph.keyframe_ids, ends)
    for keyframe in graph.keyframe_ids[part != part[0]]:
        yield f"no edge connects keyframe {keyframe} to the first one"
