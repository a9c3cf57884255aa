"""Where in a map of any size a query may be: pairs of objects propose poses, the likelihood of all objects orders them.

The index of pairs (:mod:`descriptors.descriptellation_lr.pair_index`) gives the pairs of the map that each pair of the
query may be. Such a match is a pose; those of right matches meet, and the poses on which the likeliest matches agree
are candidates. Each candidate is fitted to all objects that meet one of their class there, and scored by their
log-likelihood ratio: an object that meets one counts by how exactly it does, one that meets none costs little.
"""

import numpy as np
from scipy.spatial import cKDTree

from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.descriptellation_lr.pairs import DENSITY, spacing_m
from logs.records import frozen
from slam.common.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from slam.common.geometry import transform_from_xyz_yaw
from slam.object_map.submap import Submap
from slam.place_recognition.landmark_pairs import LandmarkPairs

SAME_TURN_RAD = 0.2
"""Poses that differ by less than that, and by less than half a spacing, are one."""


@frozen
class Place:
    """A candidate pose of a query: ``T_local_query`` (4, 4), in the odometry frame of the traversal around ``travel_m``
    of a ``segment``.

    ``proposer``: one of those of :class:`logs.messages.LoopClosureRecord`;
    ``predicted_by``: the keyframe whose closure predicts the pose, None if none does.
    """

    T_local_query: FloatArray
    travel_m: float
    segment: int
    proposer: str
    predicted_by: int | None = None


@frozen
class _Query:
    """Objects about the ``middle`` of a query, complex metres, (N,), their ``labels`` (N,), and the standard deviations
    (N,) m of each at a pose that was voted for, and at one that is fitted.
    """

    middle: complex
    objects: ComplexArray
    labels: IntArray
    voted_sigmas_m: FloatArray
    fitted_sigmas_m: FloatArray


class PlaceSearch:
    """A map that can be searched.

    Poses (2, H) of a query are where its middle is, complex metres, and its rotations, complex too.

    Args:
        pairs: the index of the map, whose objects are numbered by their rows.
        positions: (M, 3) m, z up.
        labels: (M,) numbers of classes, below ``class_count``.
    """

    def __init__(
        self, pairs: PairIndex | LandmarkPairs, positions: FloatArray, labels: IntArray, class_count: int
    ) -> None:
        self._pairs = pairs
        self._positions = positions
        plane = np.asarray(positions[:, :2], dtype=np.float64)
        self._plane = plane[:, 0] + 1j * plane[:, 1]
        self._spacing_m = max(spacing_m(plane), float(np.finfo(np.float32).eps))
        # On a third axis objects of different classes are farther apart than any map is wide.
        self._pitch_m = 1e6 * self._spacing_m
        self._tree = cKDTree(np.column_stack([plane, self._pitch_m * labels]))
        shares = np.maximum(np.bincount(labels, minlength=class_count), 1) / max(len(labels), 1)
        self._densities = DENSITY / self._spacing_m**2 * shares

    def near(self, place: FloatArray, radius_m: float) -> IntArray:
        """Rows (K,), ascending, of the objects within ``radius_m`` of a place (2,) m."""
        thirds = self._pitch_m * np.arange(len(self._densities))  # one a class
        found = self._tree.query_ball_point(np.column_stack([np.tile(place, (len(thirds), 1)), thirds]), radius_m)
        return np.sort(np.concatenate(found).astype(np.int64))

    def count_met(self, query: Submap, T_map_query: FloatArray) -> IntArray:
        """How many objects of a query, whose classes the map has, meet one of their class at each pose (H, 4, 4)."""
        placed = _query(query.positions, query.labels, query.sigmas)
        apart_m, _ = self._met(_of_middle(T_map_query, placed.middle), placed, query.sigmas)
        return np.isfinite(apart_m).sum(axis=1)

    def find_poses(
        self, query: Submap, *, count: int, map_sigma_m: float = 0.0, allowed: BoolArray | None = None
    ) -> FloatArray:
        """The likeliest poses (H, 4, 4) of a query in the map, at most ``count``, best first.

        Args:
            query: objects in a frame whose z points up, their classes numbered as in the map; those of further classes
                are left out.
            count: how many poses are wanted.
            map_sigma_m: of a coordinate of an object of the map, where those of the query do not include it.
            allowed: which objects (M,) of the map may make a pair; all by default.
        """
        known = np.flatnonzero(query.labels < len(self._densities))
        if len(known) < 2:
            return np.zeros((0, 4, 4))
        positions, labels = query.positions[known], query.labels[known]
        # Scored by all of its noise, a query of which the map has a part only meets as much elsewhere by chance.
        local_m = query.sigmas[known] if query.local_sigma_m is None else np.full(len(known), query.local_sigma_m)
        sigmas_m = np.hypot(local_m, map_sigma_m)
        matches = self._pairs.search(positions, labels, sigmas_m=sigmas_m, allowed=allowed)
        if not len(matches.nats):
            return np.zeros((0, 4, 4))
        # Every match has a vote, also an unlikely one: many of them agree only at the right place. Two poses of a right
        # match differ by 1.8 standard deviations of a coordinate over the length of a pair.
        rows, ends = np.unique(matches.entries, return_inverse=True)
        T_voted = vote_for_poses(
            positions,
            self._positions[rows].astype(np.float64),
            matches.queries,
            ends.reshape(-1, 2),
            np.maximum(matches.nats, 0.1),
            tolerance_m=1.8 * np.median(sigmas_m),
            count=max(count, 600),  # with 200, 7 of 100 places with much clutter are missed
        )
        placed = _query(positions, labels, sigmas_m)
        voted = _of_middle(T_voted, placed.middle)
        scores = self._log_likelihood_ratios(voted, placed, placed.voted_sigmas_m)
        likeliest = _likeliest(scores)[: max(count, 40)]  # with 200 no more places are found
        fitted = voted[:, likeliest]
        # After one round with either noise, right poses 2 m off are not yet better than others.
        for fit_sigmas_m in 3 * [placed.voted_sigmas_m] + 3 * [placed.fitted_sigmas_m]:
            fitted = self._fitted(fitted, placed, fit_sigmas_m)
        scores = self._log_likelihood_ratios(fitted, placed, placed.fitted_sigmas_m)
        chosen = self._distinct(fitted, scores, count)
        middles, turns = fitted[:, chosen]
        origins = middles - turns * placed.middle
        places = np.column_stack([origins.real, origins.imag, T_voted[likeliest[chosen], 2, 3]])
        return transform_from_xyz_yaw(places, np.angle(turns))

    def _met(self, poses: ComplexArray, query: _Query, sigmas_m: FloatArray) -> tuple[FloatArray, ComplexArray]:
        """Distance [m] of each object of a query at each pose to the nearest of its class, and where that is: (H, N)
        each, infinite and 0 where there is none in reach.
        """
        placed = poses[0][:, None] + poses[1][:, None] * query.objects
        classes = np.broadcast_to(self._pitch_m * query.labels, placed.shape)
        asked = np.stack([placed.real, placed.imag, classes], axis=-1).reshape(-1, 3)
        # Of 1000 pairs of observations of one object 2 are farther apart in the plane than 3.5 standard deviations. No
        # farther than the next object of the map, or chance would draw the fit.
        reach_m = np.minimum(3.5 * sigmas_m, self._spacing_m)
        found = self._tree.query(asked, distance_upper_bound=float(reach_m.max()))
        apart_m, rows = (np.reshape(each, placed.shape) for each in found)
        is_met = apart_m <= reach_m
        return np.where(is_met, apart_m, np.inf), np.where(is_met, self._plane[np.where(is_met, rows, 0)], 0.0)

    def _fitted(self, poses: ComplexArray, query: _Query, sigmas_m: FloatArray) -> ComplexArray:
        """The poses by weighted least squares over what the query meets there; those that meet little as they are."""
        apart_m, met = self._met(poses, query, sigmas_m)
        weights = np.where(np.isfinite(apart_m), 1.0 / sigmas_m**2, 0.0)
        has_enough = (weights > 0.0).sum(axis=1) >= 3  # two always fit
        weights[~has_enough] = 1.0
        weights /= weights.sum(axis=1, keepdims=True)
        mean_query, mean_met = weights @ query.objects, (weights * met).sum(axis=1)
        turns = (weights * (met - mean_met[:, None]) * (query.objects - mean_query[:, None]).conj()).sum(axis=1)
        has_enough &= np.abs(turns) > 0.0
        turns /= np.maximum(np.abs(turns), np.finfo(np.float64).tiny)
        return np.where(has_enough, [mean_met - turns * mean_query, turns], poses)

    def _log_likelihood_ratios(self, poses: ComplexArray, query: _Query, sigmas_m: FloatArray) -> FloatArray:
        """Of the objects of a query being those of the map at each pose, against any others, up to a constant: (H,).

        Three of four are, the others are missing in the map or clutter.
        """
        apart_m, _ = self._met(poses, query, sigmas_m)
        variance = sigmas_m**2
        density = np.exp(-0.5 * apart_m**2 / variance) / (2.0 * np.pi * variance)
        return np.log1p(3.0 * density / self._densities[query.labels]).sum(axis=1)

    def _distinct(self, poses: ComplexArray, scores: FloatArray, count: int) -> IntArray:
        """Rows of the poses with the highest scores, ``count`` at most; of those that are one, the first."""
        chosen, (middles, turns) = list[int](), poses
        for row in _likeliest(scores).tolist():
            near = np.abs(middles[chosen] - middles[row]) < 0.5 * self._spacing_m
            near &= np.abs(np.angle(turns[chosen] * turns[row].conj())) < SAME_TURN_RAD
            if not near.any():
                chosen.append(row)
            if len(chosen) == count:
                break
        return np.array(chosen, dtype=np.int64)


def _likeliest(scores: FloatArray) -> IntArray:
    """Rows of poses in the order of their scores (H,), of equal ones in the given order, that of their votes.

    What differs in the seventh decimal is rounding.
    """
    return np.argsort(-np.round(scores, 6), kind="stable")


def _of_middle(T_map_query: FloatArray, middle: complex) -> ComplexArray:
    """The poses (2, H) at (H, 4, 4) of a query whose middle is there, complex metres."""
    turns = T_map_query[:, 0, 0] + 1j * T_map_query[:, 1, 0]
    return np.array([T_map_query[:, 0, 3] + 1j * T_map_query[:, 1, 3] + turns * middle, turns])


def _query(positions: FloatArray, labels: IntArray, sigmas_m: FloatArray) -> _Query:
    plane = positions[:, 0] + 1j * positions[:, 1]
    middle = plane.mean()
    from_middle = np.abs(plane - middle)
    radius_m = max(np.sqrt(np.mean(from_middle**2)), np.finfo(np.float64).tiny)
    # The place of a voted pose is the mean of two objects, that of a fitted one of several; the heading of a voted pose
    # moves objects the more, the farther from the middle they are.
    sigma_m = np.median(sigmas_m)
    voted = np.sqrt(sigmas_m**2 + sigma_m**2 * (0.5 + 2.0 * (from_middle / radius_m) ** 2))
    fitted = np.sqrt(sigmas_m**2 + 0.4 * sigma_m**2)
    return _Query(middle, plane - middle, labels, voted, fitted)


def vote_for_poses(
    query_positions: FloatArray,
    reference_positions: FloatArray,
    queries: IntArray,
    references: IntArray,
    weights: FloatArray,
    *,
    tolerance_m: float,
    count: int,
) -> FloatArray:
    """The poses (H, 4, 4) of a query with most votes, at most ``count``, the best first: the mean of each cell.

    This is a generalised Hough transform (Ballard, PR 1981). Two matched objects determine yaw and translation. The
    poses of wrong matches are spread over the whole map and all headings. Those of right matches are in one cell, or a
    few that adjoin, whose size is the accuracy of the pose of a match.

    Args:
        query_positions: (N, 3) m, z up.
        reference_positions: (M, 3) m, z up.
        queries: (C, 2) rows of the query, of C matches, one at least.
        references: (C, 2) rows of the map.
        weights: (C,) of their votes.
        tolerance_m: by how much lengths of a match may differ.
        count: how many poses are wanted.
    """
    # About the middle of the query, where the noise of the headings moves it least, and near the middle of the map.
    middle, far = query_positions.mean(axis=0), reference_positions.mean(axis=0)
    query, reference = (query_positions - middle)[queries], (reference_positions - far)[references]
    q, r = (points[:, :, 0] + 1j * points[:, :, 1] for points in (query, reference))
    query_way, way = (points[:, 1] - points[:, 0] for points in (q, r))
    turns = way * query_way.conj()
    turns /= np.maximum(np.abs(turns), np.finfo(np.float64).tiny)
    places = r.mean(axis=1) - turns * q.mean(axis=1)
    rises = (reference - query)[:, :, 2].mean(axis=1)
    # A match turns by its tolerance over its size, and moves the middle of the query by that times its distance.
    heading_rad = tolerance_m / np.median(np.abs(query_way))
    edge_m = tolerance_m + heading_rad * np.sqrt(np.mean((query_positions - middle)[:, :2] ** 2) * 2.0)
    headings = max(int(np.pi / heading_rad), 4)
    x, y = (np.floor((part - part.min()) / edge_m).astype(np.int64) for part in (places.real, places.imag))
    heading = np.floor((np.angle(turns) + np.pi) * (headings / (2.0 * np.pi))).astype(np.int64) % headings
    _, voted = np.unique((x * (y.max() + 1) + y) * headings + heading, return_inverse=True)
    totals = np.bincount(voted, weights)
    best = np.argsort(-totals, kind="stable")[:count]
    parts = places.real, places.imag, rises, turns.real, turns.imag
    means = np.column_stack([np.bincount(voted, weights * part)[best] / totals[best] for part in parts])
    T = transform_from_xyz_yaw(means[:, :3], np.arctan2(means[:, 4], means[:, 3]))
    T[:, :3, 3] += far - T[:, :3, :3] @ middle
    return T
