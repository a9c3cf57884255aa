"""A long drive through the same places keeps the graph of two traversals.

As in reduced pose graphs (Johannsson et al., ICRA 2013), a place that was passed often gets no new variables; here the
observations from there go to the keyframe of the second traversal, and landmarks stay variables. The first traversal
stays as it is: its keyframes hold the shape of the map, and a keyframe attached to one counts as known relative to it.
"""

import logging
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from scipy import sparse

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Observation
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import FactorGraphError
from slam.frontend.pending_observations import GROUP_KEYFRAMES
from slam.loop_closure.accepted_closures import AcceptedClosures
from slam.loop_closure.landmark_fusion import fuse_landmarks
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
        self._objects = config.calibration.objects
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
            self.fuse_landmarks()
            anchors = self._anchors()
            try:
                self._graph.condense(anchors)
            except FactorGraphError as error:
                logger.info("the graph stays as it is: %s", error)
            else:
                self._closures.forget_condensed()
                self._counters["keyframes_condensed"] += len(anchors)
                logger.info("condensed the graph: %d keyframes attached, %d remain", len(anchors), self._variable_count)
        self._due_at = max(MIN_KEYFRAMES, 2 * self._variable_count)

    @property
    def _variable_count(self) -> int:
        """How many keyframes are variables of the graph."""
        return len(self._keyframes) - self._counters["keyframes_condensed"]

    def fuse_landmarks(self) -> None:
        """Fuse duplicate landmarks at the optimum."""
        self._graph.optimize(roughly=True)
        self._counters["landmarks_fused"] += fuse_landmarks(self._map, self._graph, self._objects)

    def _anchors(self) -> dict[int, int]:
        variables = self._graph.keyframe_variables
        of = [self._keyframes[keyframe] for keyframe in variables.tolist()]
        travel_m = np.array([each.odometry.travel_m for each in of])
        in_use = self._graph.anchors
        now_m = self._keyframes[-1].odometry.travel_m
        settled_m = min(self._closures.settled_before_m(now_m), now_m - self._min_travel_m)
        return find_anchors(
            [
                (each.keyframe, self._map.canonical[each.landmark])
                for each in self._graph.factors.values()
                if isinstance(each, Observation)
            ],
            variables,
            travel_m,
            is_settled=(travel_m < settled_m) & np.array([not (each.is_prior or each.id in in_use) for each in of]),
            may_anchor=variables % GROUP_KEYFRAMES == 0,
            min_travel_m=self._min_travel_m,
        )


def find_anchors(
    observations: Iterable[tuple[int, int]],
    keyframes: IntArray,
    travel_m: FloatArray,
    *,
    is_settled: BoolArray,
    may_anchor: BoolArray,
    min_travel_m: float,
) -> dict[int, int]:
    """The keyframes that can be attached to one of an earlier traversal, with that anchor.

    A keyframe is of a place that was passed before if an earlier one observed three of its landmarks, which determine
    the relative pose, and half of all. It is attached to the one with most of them that was of such a place itself, and
    may be an anchor where there is none. Settled keyframes that observed nothing are attached like the next one that
    did.

    Args:
        observations: keyframe and landmark of each, by the variables of landmarks.
        keyframes: (K,) ids, ascending: in the order of the drive.
        travel_m: (K,), of each.
        is_settled: (K,), which of them may be attached.
        may_anchor: (K,), which may be anchors.
        min_travel_m: keyframes with less travel between them are of one traversal.
    """
    # Which keyframe observed which landmark, as ones in an array (K, L).
    observers, landmarks = np.unique(np.array(list(observations), dtype=np.int64).reshape(-1, 2), axis=0).T
    ones, rows = np.ones(len(observers), dtype=np.int64), np.searchsorted(keyframes, observers)
    seen = sparse.csr_array((ones, (rows, landmarks)), shape=(len(keyframes), landmarks.max(initial=-1) + 1))
    totals = np.diff(seen.indptr)
    common = (seen @ seen.T).tocsr()
    common.sort_indices()
    anchors = dict[int, int]()
    is_variable = np.zeros(len(keyframes), dtype=np.bool_)
    is_anchor = np.zeros(len(keyframes), dtype=np.bool_)
    waiting = list[int]()
    for row, keyframe in enumerate(keyframes.tolist()):
        if not totals[row]:
            waiting = [*waiting, keyframe] if is_settled[row] else []
            continue
        of_row = slice(common.indptr[row], common.indptr[row + 1])
        others, counts = common.indices[of_row], common.data[of_row]
        of_place = is_variable[others] & (travel_m[others] < travel_m[row] - min_travel_m)
        of_place &= counts >= max(3, 0.5 * totals[row])
        usable = of_place & is_anchor[others]
        if not is_settled[row] or not usable.any():
            is_variable[row] = True
            is_anchor[row] = may_anchor[row] and of_place.any()
        else:
            best = others[usable][counts[usable].argmax()]
            anchors |= dict.fromkeys((*waiting, keyframe), int(keyframes[best]))
        waiting = []
    return anchors
