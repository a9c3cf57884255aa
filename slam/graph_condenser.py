"""When the graph is condensed: a long drive through the same places keeps the graph of two traversals."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence

import numpy as np

from slam.backend.condensing.anchors import find_anchors
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Observation
from slam.backend.solver_options import GROUP_KEYFRAMES
from slam.common.config import Config
from slam.loop_closure.accepted_closures import AcceptedClosures
from slam.loop_closure.landmark_fusion import fuse_duplicate_landmarks
from slam.object_map.landmarks import ObjectMap
from slam.odometry.keyframe import Keyframe

logger = logging.getLogger(__name__)

MIN_KEYFRAMES = 3000
"""A graph of so few keyframes, some 200 MB, is never condensed."""


class GraphCondenser:
    """Attaches keyframes of later traversals to those of the second one, once the graph has outgrown the map."""

    def __init__(
        self,
        config: Config,
        object_map: ObjectMap,
        graph: FactorGraph,
        keyframes: Sequence[Keyframe],
        closures: AcceptedClosures,
        counters: Counter[str],
    ) -> None:
        """``counters``: of attached keyframes and fused landmarks."""
        self._min_travel_m = config.closure_travel_m
        self._radius_m = 2.0 * config.calibration.objects.landmark_sigma_m
        self._map = object_map
        self._graph = graph
        self._keyframes = keyframes
        self._closures = closures
        self._counters = counters
        self._due_at = MIN_KEYFRAMES

    def update(self) -> None:
        """Condense the graph if it is due: again once it has twice the keyframes that it had afterwards.

        A solution of the whole graph is worth it if a quarter of them goes.
        """
        # Keyframes in a map without a trajectory are tied to its frame, not to one another.
        if self._variable_count < self._due_at or self._keyframes[0].is_map_frame:
            return
        if len(self._anchors()) >= 0.25 * self._variable_count:
            self._condense()
        self._due_at = max(MIN_KEYFRAMES, 2 * self._variable_count)

    @property
    def _variable_count(self) -> int:
        """How many keyframes are variables of the graph."""
        return len(self._keyframes) - self._counters["keyframes_condensed"]

    def fuse_landmarks(self) -> None:
        """Fuse duplicate landmarks at the optimum."""
        self._graph.optimize(roughly=True)
        nearby = self._closures.keyframes_nearby()
        fused = fuse_duplicate_landmarks(self._map, self._graph, nearby, radius_m=self._radius_m)
        self._counters["landmarks_fused"] += fused

    def _condense(self) -> None:
        self._graph.settle()
        self.fuse_landmarks()
        self._graph.optimize(roughly=True)
        anchors = self._anchors()
        self._graph.condense(anchors)
        self._closures.forget_condensed()
        self._counters["keyframes_condensed"] += len(anchors)
        logger.info("condensed the graph: %d keyframes attached, %d remain", len(anchors), self._variable_count)

    def _anchors(self) -> dict[int, int]:
        variables = self._graph.keyframe_variables
        of = [self._keyframes[keyframe] for keyframe in variables.tolist()]
        travel_m = np.array([each.odometry.travel_m for each in of])
        now_m = self._keyframes[-1].odometry.travel_m
        settled_m = min(self._closures.settled_before_m(now_m), now_m - self._min_travel_m)
        return find_anchors(
            [
                (each.keyframe, self._map.canonical_id(each.landmark))
                for each in self._graph.factors.values()
                if isinstance(each, Observation)
            ],
            variables,
            travel_m,
            is_settled=(travel_m < settled_m) & np.array([not each.is_prior for each in of]),
            may_anchor=variables % GROUP_KEYFRAMES == 0,
            min_travel_m=self._min_travel_m,
        )
