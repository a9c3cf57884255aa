"""Localization of a few objects in a map without any descriptor: every pair against every pair.

What a descriptor must be better than, or faster. Two objects of the query that are two objects of the map determine
x, y and yaw. All pairs of the map are sorted by their two classes and their length, so that those a pair of the query
can be are one stretch of that list, and each of them is a pose that is scored by all objects of the query.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.common.errors import GeometryError
from slam.common.geometry import transform_from_xyz_yaw
from slam.registration.class_raster import make_class_raster
from slam.registration.estimate import Registration, not_found
from slam.registration.object_pairs import MapPairs, QueryPairs, query_pairs
from slam.registration.parameters import RegistrationConfig
from slam.registration.registration import refine_many

SURE_INLIERS = 4
"""Objects that the pairs already tried must share with every better pose before the others are not tried.

Two would do, were each of their pairs long enough to propose the pose well."""
OBJECTS_A_ROUND = 3
"""Objects after which poses that cannot become one of the best are let go."""
CELL_FRACTION = 0.25
"""Edge of a cell of the raster, as a fraction of ``distinct_m``."""
FARTHEST_GATE_FACTOR = 3.0
"""Objects that many times ``distinct_m`` from where they should be count as missing, however large the noise."""
REACH_FACTOR = 30.0
"""Longest pairs that are compared, in multiples of ``distinct_m``, where no other length is asked for."""
LEADERS = 16
"""Distinct poses with the best scores, which are refined."""
CROWD = 8
"""... and times as many of each chunk are looked through for them, as each right pair proposes nearly the same."""


class ExhaustiveSearch:
    """All pairs of a map that are within ``reach_m`` of each other, and where its objects are; built once for a map.

    Args:
        positions: (M, 3) m, gravity-aligned.
        labels: (M,).
        config: gates and limits, ``estimate_scale`` among them.
        reach_m: the longest pairs that are compared: the diameter of the query; by default ``REACH_FACTOR`` times
            ``distinct_m``.
        map_sigmas: (M,) m, noise of a position along any axis.

    Raises:
        GeometryError: arrays that do not fit together or values that are not finite, no object, or objects so far
            apart that the raster would not fit into memory.
    """

    def __init__(
        self,
        positions: FloatArray,
        labels: IntArray,
        config: RegistrationConfig,
        *,
        reach_m: float | None = None,
        map_sigmas: FloatArray,
    ) -> None:
        _check("map", positions, labels, map_sigmas)
        if not len(positions):
            raise GeometryError("a map of no objects; give it at least one")
        self._config = config
        self._positions, self._labels, self._sigmas = positions, np.asarray(labels, np.int64), map_sigmas
        self._vocabulary, classes = np.unique(self._labels, return_inverse=True)
        # Complex numbers about the middle of the map: rotations are products, and far coordinates lose no digits.
        self._middle = positions.mean(axis=0)
        planar = positions[:, :2] - self._middle[:2]
        self._plane = planar[:, 0] + 1j * planar[:, 1]
        self._tree = cKDTree(planar)
        longest_m = REACH_FACTOR * config.distinct_m if reach_m is None else reach_m
        self._pairs = MapPairs.of(self._plane, classes, self._tree, len(self._vocabulary), longest_m)
        self._farthest_gate_m = FARTHEST_GATE_FACTOR * config.distinct_m
        self._raster = make_class_raster(
            planar,
            classes,
            len(self._vocabulary),
            reach_m=self._farthest_gate_m,
            cell_m=CELL_FRACTION * config.distinct_m,
        )
        # The last object is the one that is not there: infinitely far, with any noise.
        self._looked_up = np.append(self._plane, complex(np.inf, np.inf))
        self._variances = np.append(map_sigmas**2, 1.0)
        self._map_sigma_m = float(map_sigmas.max())

    def localize(
        self, query_positions: FloatArray, query_labels: IntArray, *, query_sigmas: FloatArray
    ) -> Registration:
        """The pose of the query in the map that its objects support best; see :meth:`leading`.

        Returns:
            The pose, its inliers as (query, map) indices and its score; or the answer "no" with its reason.
        """
        return self.leading(query_positions, query_labels, query_sigmas=query_sigmas)[0]

    def leading(
        self, query_positions: FloatArray, query_labels: IntArray, *, query_sigmas: FloatArray
    ) -> list[Registration]:
        """The distinct poses of the query in the map that its objects support best, best first.

        A pose's score is the sum over the query's objects of 1 - (residual / gate)^2, where the residual is that to the
        nearest object of the same label and inside the gate (MSAC: Torr and Zisserman, CVIU 2000). The best distinct
        poses are refined. The same query has the same answer.

        Args:
            query_positions: (N, 3) m, gravity-aligned, about the sensor.
            query_labels: (N,), numbered as those of the map.
            query_sigmas: (N,) m, noise of a position along any axis.

        Returns:
            Poses, their inliers as (query, map) indices and their scores; or one answer "no" with its reason.

        Raises:
            GeometryError: arrays that do not fit together or values that are not finite.
        """
        _check("query", query_positions, query_labels, query_sigmas)
        place = np.minimum(np.searchsorted(self._vocabulary, query_labels), len(self._vocabulary) - 1)
        known = np.flatnonzero(self._vocabulary[place] == query_labels)
        if len(known) < self._config.min_inliers:
            return _none(
                f"{len(known)} of the {len(query_labels)} objects have a label of the map; "
                f"a pose needs {self._config.min_inliers}"
            )
        planar = query_positions[known, 0] + 1j * query_positions[known, 1]
        query = _Query(planar, place[known], query_sigmas[known] ** 2)
        leaders = self._best_poses(query)
        if not len(leaders.scores):
            return _none(
                f"no pair of the {len(known)} objects, at least {self._config.min_baseline_m:g} m apart, "
                "is as long as a pair of the map with the same labels"
            )
        return self._refined(leaders, query_positions, np.asarray(query_labels, np.int64), query_sigmas, known)

    def _best_poses(self, query: _Query) -> _Poses:
        """The distinct poses with the best scores, best first."""
        pairs = query_pairs(
            self._pairs, query.plane, query.classes, query.variances, self._config, map_sigma_m=self._map_sigma_m
        )
        count = len(query.plane)
        leaders = _Poses.none()
        for complete, chosen, row in pairs.proposals():
            best = int(leaders.scores.max(initial=0.0))
            # None counts more than 1, so that a better pose has at least best + 1 inliers; no more of them than there
            # are objects left can be outside the first ones, all pairs of which are tried.
            if best + 1 - (count - complete) >= SURE_INLIERS:
                break
            floor = float(leaders.scores[-1]) if len(leaders.scores) == LEADERS else 0.0
            scored = self._scored(query, self._proposed(query, pairs, chosen, row), pairs.order, floor)
            leaders = leaders.joined(scored).distinct(query.plane.mean(), self._config)
        return leaders

    def _proposed(self, query: _Query, pairs: QueryPairs, chosen: IntArray, row: IntArray) -> _Poses:
        """The poses at which the pairs ``chosen`` (H,) of the query lie on the pairs ``row`` (H,) of the map."""
        i, j = pairs.first[chosen], pairs.second[chosen]
        a, b = self._pairs.first[row], self._pairs.second[row]
        from_a, from_b = self._plane[a], self._plane[b]
        baseline = query.plane[j] - query.plane[i]
        variance_a = query.variances[i] + self._variances[a]
        variance_b = query.variances[j] + self._variances[b]
        turn = (from_b - from_a) * baseline.conj()
        length = np.abs(turn)
        turn /= length
        if self._config.estimate_scale:
            # The mean of the pair's scale and the expected one, 1, each with its precision.
            weight, prior = 1.0 / (variance_a + variance_b), self._config.scale_sigma**-2
            turn *= (length * weight + prior) / (np.abs(baseline) ** 2 * weight + prior)
        share = variance_b / (variance_a + variance_b)
        shift = share * (from_a - turn * query.plane[i]) + (1.0 - share) * (from_b - turn * query.plane[j])
        return _Poses(turn, shift, np.zeros(len(turn)))

    def _scored(self, query: _Query, poses: _Poses, order: IntArray, floor: float) -> _Poses:
        """Those of the poses that have scores above ``floor``, with these; objects are asked in ``order`` (N,)."""
        turn, shift, scores = poses.turn, poses.shift, poses.scores
        for asked, which in enumerate(order.tolist(), start=1):
            scores += self._support(query, which, turn * query.plane[which] + shift)
            left = len(order) - asked
            if asked % OBJECTS_A_ROUND == 0 or left == 0:
                # No object adds more than one, so that the others cannot rise above the floor.
                hopeful = np.flatnonzero(scores + left > floor)
                if len(hopeful) < len(scores):
                    turn, shift, scores = turn[hopeful], shift[hopeful], scores[hopeful]
        return _Poses(turn, shift, scores)

    def _support(self, query: _Query, which: int, at: ComplexArray) -> FloatArray:
        """What the object ``which`` of the query adds to the scores of poses that put it ``at`` (H,)."""
        nearest = self._raster.nearest(int(query.classes[which]), at)
        offset = np.subtract(self._looked_up.take(nearest), at, out=at).view(np.float64)
        offset *= offset
        ratio = offset[::2] + offset[1::2]
        variance = self._variances.take(nearest)
        variance += query.variances[which]
        variance *= self._config.gate_sigma**2
        ratio /= variance
        np.subtract(1.0, ratio, out=ratio)
        return np.asarray(np.maximum(ratio, 0.0, out=ratio))

    def _refined(
        self, leaders: _Poses, positions: FloatArray, labels: IntArray, sigmas: FloatArray, known: IntArray
    ) -> list[Registration]:
        """The refined poses, best first, from the part of the map that the query can lie on."""
        centre = complex(*positions[:, :2].mean(axis=0))
        radius_m = float(np.hypot(*(positions[known, :2] - [centre.real, centre.imag]).T).max())
        sizes = np.abs(leaders.turn)
        middles = leaders.turn * centre + leaders.shift
        # Each leader has an object within the farthest gate, so that no part is empty.
        near = self._tree.query_ball_point(
            np.column_stack([middles.real, middles.imag]), sizes * radius_m + 2.0 * self._farthest_gate_m
        )
        part = np.unique(np.concatenate([np.asarray(objects, np.int64) for objects in near]))
        heights = np.array([np.median(self._positions[objects, 2]) for objects in near])
        # Refinement starts at scale 1, which must not move the middle of the objects.
        start = middles - leaders.turn / sizes * centre
        shift = np.column_stack([start.real, start.imag, heights - np.median(positions[known, 2])])
        shift[:, :2] += self._middle[:2]
        answers = refine_many(
            positions,
            labels,
            self._positions[part],
            self._labels[part],
            transform_from_xyz_yaw(shift, np.angle(leaders.turn)),
            self._config,
            query_sigmas=sigmas,
            reference_sigmas=self._sigmas[part],
        )
        found = sorted((answer for answer in answers if answer.found), key=lambda answer: -answer.score)
        if not found:
            return [answers[0]]
        return [replace(each, pairs=np.column_stack([each.pairs[:, 0], part[each.pairs[:, 1]]])) for each in found]


@dataclass(frozen=True, slots=True, eq=False)
class _Poses:
    """Level poses (H,) of the query: ``turn``, as long as the scale, times a point, plus ``shift`` m.

    ``scores`` are the sums over the query's objects.
    """

    turn: ComplexArray
    shift: ComplexArray
    scores: FloatArray

    @classmethod
    def none(cls) -> _Poses:
        empty = np.zeros(0, dtype=np.complex128)
        return cls(empty, empty, np.zeros(0))

    def joined(self, other: _Poses) -> _Poses:
        """These, then the best of the others."""
        best = np.argsort(-other.scores, kind="stable")[: CROWD * LEADERS]
        return _Poses(
            np.concatenate([self.turn, other.turn[best]]),
            np.concatenate([self.shift, other.shift[best]]),
            np.concatenate([self.scores, other.scores[best]]),
        )

    def distinct(self, centre: complex, config: RegistrationConfig) -> _Poses:
        """Best first those that are not near a better one, at the ``centre`` of the objects."""
        order = np.argsort(-self.scores, kind="stable")
        turn, shift = self.turn[order], self.shift[order]
        place = turn * centre + shift
        kept: list[int] = []
        free = np.ones(len(turn), dtype=bool)
        cosine = np.cos(np.radians(config.distinct_deg))
        while len(kept) < LEADERS and free.any():
            leader = int(free.argmax())
            kept.append(leader)
            product = turn * turn[leader].conj()
            alike = product.real >= cosine * np.abs(product)
            free &= ~(alike & (np.abs(place - place[leader]) <= config.distinct_m))
            free[leader] = False
        return _Poses(turn[kept], shift[kept], self.scores[order[kept]])


@dataclass(frozen=True, slots=True, eq=False)
class _Query:
    """N objects whose classes the map has: where in the plane (N,), m, and their variances (N,), m^2."""

    plane: ComplexArray
    classes: IntArray
    variances: FloatArray


def _none(reason: str) -> list[Registration]:
    return [not_found(reason)]


def _check(name: str, positions: FloatArray, labels: IntArray, sigmas: FloatArray) -> None:
    count = len(positions)
    if positions.ndim != 2 or positions.shape[1] != 3 or np.shape(labels) != (count,) or sigmas.shape != (count,):
        raise GeometryError(
            f"{name}: positions {positions.shape}, labels {np.shape(labels)} and sigmas {sigmas.shape} do not fit; "
            "give (N, 3), (N,) and (N,)"
        )
    if not np.isfinite(positions).all():
        raise GeometryError(f"{name}: a position is not finite")
    if not (np.isfinite(sigmas).all() and (sigmas > 0.0).all()):
        raise GeometryError(f"{name}: a sigma is not finite and positive")
