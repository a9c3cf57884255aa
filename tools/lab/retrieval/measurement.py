"""What descriptors give: places proposed at the revisits of a drive, by descriptors and their verification alone.

No closure is propagated, and no other retrieval helps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from descriptors.constellation import Constellations, gather_constellations
from descriptors.index import ConstellationIndex, Matches
from descriptors.registry import make_index
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import apply, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.place_recognition.retrieval import DESCRIPTOR_RANGE_M
from slam.registration.parameters import registration_config
from slam.registration.registration import register
from tools.lab.retrieval.recorded_places import AskedPlace, RecordedPlaces

RECALL_AT = (1, 5, 25)


def measure_retrieval(
    recorded: RecordedPlaces,
    descriptors: Sequence[str],
    *,
    neighbours: int | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> list[dict[str, Any]]:
    """Ask each descriptor at all revisits of a drive.

    ``places_at_k``: share of the queries with a right pose among the first k proposals, by k of :data:`RECALL_AT`.
    ``objects_at_k``: of the objects of a query that the map has, those whose counterpart is among their first k
    matches. ``match_ms``, ``verify_ms``: of a query, medians. ``index_s``: time to describe the ``entries`` of the map.

    Args:
        recorded: the drive.
        descriptors: names, as the registry has them.
        neighbours: matches of each object; None: as many as loop closing takes (``loop_closure.top_k``).
        on_progress: called with the fraction done, in [0, 1].

    Raises:
        DescriptorError: a descriptor that does not exist, or that does not fit the drive.
    """
    indices = [make_index(name) for name in descriptors]  # what cannot be made is refused before anything is measured
    figures = []
    with threadpool_limits(1):
        for number, (name, index) in enumerate(zip(descriptors, indices, strict=True)):
            asking = _Asking(recorded, index, neighbours or recorded.config.loop_closure.top_k)
            for done, place in enumerate(recorded.asked, start=1):
                asking.ask(place)
                if on_progress is not None:
                    on_progress((number + done / len(recorded.asked)) / len(descriptors))
            figures.append(asking.figures(name))
    return figures


class _Asking:
    """One descriptor on its way through the drive."""

    def __init__(self, recorded: RecordedPlaces, index: ConstellationIndex, neighbours: int) -> None:
        self._recorded = recorded
        self._index = index
        self._neighbours = neighbours
        self._scale = DESCRIPTOR_RANGE_M / recorded.config.sensor_range_m
        self._parts = 0
        self._index_s = 0.0
        self._match_s: list[float] = []
        self._verify_s: list[float] = []
        self._place_hits = np.zeros(len(RECALL_AT))
        self._object_hits: list[FloatArray] = []

    def ask(self, place: AskedPlace) -> None:
        """Add the landmarks that were mapped before a query to the index, and propose places of the query."""
        for part in self._recorded.parts[self._parts : place.parts]:
            started = time.perf_counter()
            self._index.add(self._gather(part.positions, part.labels, part.vocabulary, part.centres))
            self._index_s += time.perf_counter() - started
        self._parts = max(self._parts, place.parts)
        started = time.perf_counter()
        asking = self._gather(place.submap.positions, place.submap.labels, place.vocabulary, None)
        matches = self._index.search(asking, self._neighbours, place.allowed)
        matched = time.perf_counter()
        proposals = self._verify(place, matches)
        self._match_s.append(matched - started)
        self._verify_s.append(time.perf_counter() - matched)
        right = np.flatnonzero(is_right(proposals, place.T_local_query_gt))
        first = int(right[0]) if len(right) else np.inf
        self._place_hits += [first < k for k in RECALL_AT]
        hits = self._count_objects(place, matches)
        if hits is not None:
            self._object_hits.append(hits)

    def figures(self, name: str) -> dict[str, Any]:
        """What came of it."""
        queries = len(self._recorded.asked)
        objects = np.mean(self._object_hits, axis=0) if self._object_hits else np.zeros(len(RECALL_AT))
        return {
            "drive": self._recorded.drive,
            "descriptor": name,
            "queries": queries,
            "entries": len(self._index),
            **{f"places_at_{k}": hits / queries for k, hits in zip(RECALL_AT, self._place_hits.tolist(), strict=True)},
            **{f"objects_at_{k}": share for k, share in zip(RECALL_AT, objects.tolist(), strict=True)},
            "match_ms": 1e3 * float(np.median(self._match_s)),
            "verify_ms": 1e3 * float(np.median(self._verify_s)),
            "index_s": self._index_s,
        }

    def _gather(
        self, positions: FloatArray, labels: IntArray, vocabulary: tuple[str, ...], centres: IntArray | None
    ) -> Constellations:
        return gather_constellations(
            positions * self._scale, labels, vocabulary, radius_m=self._index.radius_m, centres=centres
        )

    def _verify(self, place: AskedPlace, matches: Matches) -> FloatArray:
        """Proposed poses (H, 4, 4), best first."""
        config = self._recorded.config
        found = register(
            place.submap.positions,
            place.entry_positions,
            np.column_stack([matches.queries, matches.entries]),
            registration_config(config),
            query_sigmas=place.submap.sigmas,
            reference_sigmas=np.full(len(place.entry_positions), config.calibration.objects.landmark_sigma_m),
            count=RECALL_AT[-1],
        )
        poses = [each.T_reference_query for each in found if each.T_reference_query is not None]
        return np.array(poses).reshape(-1, 4, 4)

    def _count_objects(self, place: AskedPlace, matches: Matches) -> FloatArray | None:
        """Shares (3,) of the objects that the map has, by :data:`RECALL_AT`; None where it has none of them."""
        entries = np.flatnonzero(place.allowed)
        if not len(entries) or not len(place.submap):
            return None
        reach_m = registration_config(self._recorded.config).search_radius_m
        tree = cKDTree(place.entry_positions[entries, :2])
        ranks = np.arange(len(matches.queries)) - np.searchsorted(matches.queries, matches.queries)
        is_known = np.zeros(len(place.submap), dtype=bool)
        best = np.full(len(place.submap), len(matches.queries))
        for T_local_query in place.T_local_query_gt:
            there = apply(T_local_query, place.submap.positions)
            is_known |= tree.query(there[:, :2])[0] <= reach_m
            offsets = place.entry_positions[matches.entries, :2] - there[matches.queries, :2]
            right = np.hypot(offsets[:, 0], offsets[:, 1]) <= reach_m
            np.minimum.at(best, matches.queries[right], ranks[right])
        if not is_known.any():
            return None
        return np.array([float(np.mean(best[is_known] < k)) for k in RECALL_AT])


def is_right(poses: FloatArray, truth: FloatArray) -> BoolArray:
    """Which poses (H, 4, 4) are a true one (R, 4, 4), by the protocol of closures: (H,)."""
    protocol = Protocol()
    if not len(poses):
        return np.zeros(0, dtype=np.bool_)
    apart_m = np.linalg.norm(poses[:, None, :3, 3] - truth[None, :, :3, 3], axis=2)
    turn = np.swapaxes(poses[:, None, :3, :3], 2, 3) @ truth[None, :, :3, :3]
    T_turn = np.broadcast_to(np.eye(4), (*turn.shape[:2], 4, 4)).copy()
    T_turn[..., :3, :3] = turn
    near = apart_m <= protocol.closure_translation_m
    near &= rotation_angle_rad(T_turn) <= np.deg2rad(protocol.closure_rotation_deg)
    return np.asarray(near.any(axis=1))
