"""Propagation of an accepted closure: the pose that it predicts, by the odometry, for the keyframes around it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from logs.messages import LoopClosureRecord
from slam.common.config import Config
from slam.loop_closure.acceptance import Acceptance
from slam.loop_closure.candidate import Candidate, Query
from slam.loop_closure.likelihood_ratio import changed_log_likelihood_ratio
from slam.loop_closure.verification import Verifier
from slam.object_map.landmarks import ObjectMap
from slam.place_recognition.place import Place


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """The place of a query that a closure predicts, and the candidate there, or why there is none."""

    place: Place
    verified: Candidate | LoopClosureRecord


class Propagation:
    """The last accepted closure, ``seed``, and the latest queries that one may predict."""

    def __init__(
        self,
        config: Config,
        verifier: Verifier,
        acceptance: Acceptance,
        object_map: ObjectMap,
    ) -> None:
        self._distance_m = config.propagation_distance_m
        self._sensor_range_m = config.sensor_range_m
        self._verifier = verifier
        self._acceptance = acceptance
        self._map = object_map
        self._recent: deque[Query] = deque()
        self.seed: Candidate | None = None

    def reset(self) -> None:
        """Forget the seed and all queries."""
        self.seed = None
        self._recent.clear()

    def remember(self, query: Query) -> None:
        """Add the newest query."""
        self._recent.append(query)
        while self._recent[0].travel_m < query.travel_m - self._distance_m:
            self._recent.popleft()

    def queries_before(self, keyframe: int) -> Iterator[Query]:
        """The remembered queries of earlier keyframes, the latest first."""
        return (query for query in reversed(self._recent) if query.keyframe.id < keyframe)

    def predict(self, query: Query) -> Predicted | None:
        """The landmarks at the place that the seed predicts; None without a seed that is near enough."""
        if self.seed is None or query.travel_m - self.seed.travel_m > self._distance_m:
            return None
        return self.predict_from(self.seed, query)

    def predict_from(self, seed: Candidate, query: Query) -> Predicted | None:
        """The same by another closure."""
        place = self._verifier.predict(seed, query)
        if place is None:
            return None
        return Predicted(place, self._verifier.verify(query, place, seed_closure=seed.query.id))

    def confirmed(self, predicted: Predicted | None) -> Candidate | None:
        """The closure at a predicted place, if it is accepted there."""
        if predicted is None or not isinstance(predicted.verified, Candidate) or predicted.verified.is_tracked:
            return None
        candidate = predicted.verified
        agrees = self._verifier.agree(candidate.T_local_query, predicted.place.T_local_query)
        return candidate if agrees and self._acceptance.is_acceptable(candidate) else None

    def is_contradicted(self, query: Query, predicted: Predicted | None) -> bool:
        """Whether the landmarks that came into view on the last sensor range of travel contradict a predicted place."""
        if predicted is None:
            return False
        if isinstance(predicted.verified, Candidate):
            ratios = predicted.verified.log_likelihood_ratios
        else:
            ratios = self._verifier.unregistered(query, predicted.place)
        landmarks = self._map.rows[query.submap.rows]
        is_old = (landmarks["segment"] == query.keyframe.odometry.segment) & (
            landmarks["first_seen_travel_m"] <= query.travel_m - self._sensor_range_m
        )
        ratio = changed_log_likelihood_ratio(ratios[~is_old])
        return self._acceptance.is_contradicted(ratio, self._sensor_range_m)

    def is_elsewhere(self, predicted: Predicted | None, candidate: Candidate) -> bool:
        """Whether a candidate is farther than registration reaches from a predicted place."""
        if predicted is None or predicted.place.segment != candidate.reference.odometry.segment:
            return False
        apart_m = float(np.linalg.norm((predicted.place.T_local_query - candidate.T_local_query)[:2, 3]))
        return apart_m > self._verifier.reach_m
