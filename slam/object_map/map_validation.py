"""Checks that a saved map is consistent: names are unique and resolve, and its graph is connected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.backend.edge_kind import EdgeKind
from slam.common.arrays import FloatArray, IntArray
from slam.common.union_find import find_components

PROBABILITY_TOLERANCE = 1e-6
SEMIDEFINITE_TOLERANCE = 1e-6
"""How far below zero, in parts of the trace, rounding may put an eigenvalue of a landmark's covariance."""


def find_fault(objects: ObjectMapRecord, graph: FactorGraphRecord) -> str:
    """The first thing that is wrong with a map, in one line; empty where nothing is.

    Args:
        objects: its landmarks, all confirmed.
        graph: its keyframes, and what ties them and the landmarks together.
    """
    if not objects.ids or not len(graph.keyframe_ids):
        return "it is a map without landmarks or keyframes; nothing can be found in it"
    return _fault_of_objects(objects) or _fault_of_names(objects, graph) or _fault_of_graph(graph)


def parts(graph: FactorGraphRecord, counts: NDArray[np.bool_]) -> IntArray:
    """The first row (K,) of the part to which each keyframe belongs, by the edges between them that ``counts`` (E,)."""
    row_of = {int(keyframe): row for row, keyframe in enumerate(graph.keyframe_ids)}
    ends = np.array([row_of[int(keyframe)] for keyframe in graph.edge_keyframe_ids[counts].ravel()], dtype=np.int64)
    return find_components(len(row_of), ends.reshape(-1, 2))


def _fault_of_objects(objects: ObjectMapRecord) -> str:
    twice = _repeated(objects.ids)
    if twice is not None:
        return f"landmark {twice} is in it more than once"
    twice = _repeated(objects.vocabulary)
    if twice is not None:
        return f"class {twice} is in its vocabulary more than once"
    probabilities = objects.class_probabilities
    faults = {
        "is not confirmed": np.array([state != "confirmed" for state in objects.states]),
        "has a place that is not finite": ~np.isfinite(objects.positions).all(axis=1),
        "has a matrix that is not a covariance": ~_are_covariances(objects.covariances),
        "has class probabilities that do not sum to 1": (
            np.abs(probabilities.sum(axis=1) - 1.0) > PROBABILITY_TOLERANCE
        )
        | (probabilities < 0.0).any(axis=1),
        "was never seen": objects.observation_counts < 1,
    }
    return next(
        (f"landmark {objects.ids[int(wrong.argmax())]} {what}" for what, wrong in faults.items() if wrong.any()), ""
    )


def _fault_of_names(objects: ObjectMapRecord, graph: FactorGraphRecord) -> str:
    keyframes = graph.keyframe_ids.tolist()
    twice = _repeated(keyframes)
    if twice is not None:
        return f"keyframe {twice} is in it more than once"
    known = set(keyframes)
    unknown = set(graph.edge_keyframe_ids.ravel().tolist()) - known
    if unknown:
        return f"an edge of its graph ends at keyframe {min(unknown)}, which it does not have"
    unknown = set(graph.observation_keyframe_ids.tolist()) - known
    if unknown:
        return f"its graph observes from keyframe {min(unknown)}, which it does not have"
    missing = set(graph.observation_landmark_ids) - set(objects.ids)
    if missing:
        return f"its graph observes landmark {min(missing)}, which it does not have"
    kinds = set(graph.edge_kinds) - set(EdgeKind)
    return f"its graph has edges of a kind {min(kinds)!r} that is not known" if kinds else ""


def _fault_of_graph(graph: FactorGraphRecord) -> str:
    wrong = ~_are_definite(graph.edge_covariances)
    if wrong.any():
        first, second = graph.edge_keyframe_ids[int(wrong.argmax())]
        return f"edge {first} -> {second} of its graph has a covariance that is not positive definite"
    wrong = ~_are_definite(graph.observation_covariances)
    if wrong.any():
        row = int(wrong.argmax())
        return (
            f"its graph observes landmark {graph.observation_landmark_ids[row]} from keyframe "
            f"{graph.observation_keyframe_ids[row]} with a covariance that is not positive definite"
        )
    inflations = graph.observation_redundancies
    if len(inflations) and (len(inflations) != len(wrong) or (inflations <= 0.0).any()):
        return "the covariance inflations (redundancies) of the observations in its graph are not positive for each"
    ends = graph.edge_keyframe_ids
    loops = ends[np.asarray(ends[:, 0] == ends[:, 1])]
    if len(loops):
        return f"an edge of its graph leads from keyframe {loops[0, 0]} to itself"
    part = parts(graph, np.ones(len(graph.edge_kinds), dtype=np.bool_))
    loose = graph.keyframe_ids[np.flatnonzero(part != part[0])]
    return f"no edge ties keyframe {loose[0]} to the first one" if len(loose) else ""


def _are_covariances(P: FloatArray) -> NDArray[np.bool_]:
    """Which matrices (N, n, n) can be covariances, but for rounding."""
    usable = np.asarray(np.isfinite(P).all(axis=(1, 2)))
    trace = np.trace(P, axis1=1, axis2=2)
    least = np.linalg.eigvalsh(np.where(usable[:, None, None], P, 0.0))[:, 0]
    return np.asarray(usable & (trace > 0.0) & (least >= -SEMIDEFINITE_TOLERANCE * np.abs(trace)))


def _are_definite(P: FloatArray) -> NDArray[np.bool_]:
    """Which matrices (N, n, n) can weigh a measurement."""
    usable = np.asarray(np.isfinite(P).all(axis=(1, 2)))
    return np.asarray(usable & (np.linalg.eigvalsh(np.where(usable[:, None, None], P, 0.0))[:, 0] > 0.0))


def _repeated(names: Iterable[str | int]) -> str | int | None:
    return next((name for name, count in Counter(names).items() if count > 1), None)
