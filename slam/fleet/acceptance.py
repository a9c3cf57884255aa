"""Which maps are joined: all recognised places of two maps have to tell one transform between them.

A single place can be like another one by chance, and a row of trees like its neighbour. Places along a drive that are
recognised at one transform can hardly be: their log-likelihood ratios add up to that of the transform, L. Its posterior
odds, against the best other transform for the same places, L', and "the maps have no place in common", are

    log o = (L - log n) - log(1 + exp(L' - log n)),

where n is the number of poses that chance could choose from: each place of the one map, anywhere in the other, as far
as registration tells poses apart (:class:`slam.localization.pose_prior.PosePrior`). Two maps are joined if they are
wrong with a probability below ``localization.error_probability``, shared among all pairs of maps: a false join bends
everything on both sides.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logit

from slam.backend.edge_kind import EdgeKind
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import invert, yaw_rad
from slam.fleet.joins import Join
from slam.localization.map_area import MapArea
from slam.localization.pose_prior import log_volume
from slam.loop_closure.consistency import AGREE_RAD, AGREE_RANGES, CLOSURE_SIGMA_RAD
from slam.object_map.map_io import SavedMap, are_of_kind

SHARING_PLACES = 3.0
"""A landmark is in the query of its place and of those beside it, so each log-likelihood ratio counts a third."""
GATE_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class MapPair:
    """Two maps, ``first`` < ``second``, and what says where one is in the other.

    ``joins``: those that agree on one transform; ``log_odds``: its posterior log odds [nats]; ``accepted`` and, if not,
    the ``reason``.
    """

    first: int
    second: int
    joins: tuple[Join, ...]
    log_odds: float
    accepted: bool
    reason: str

    @property
    def T_first_second(self) -> FloatArray:
        """The transform (4, 4) that the join with the highest log-likelihood ratio implies."""
        return max(self.joins, key=lambda join: join.llr).T_reference_query


def search_penalty(first: SavedMap, second: SavedMap, joins: Sequence[Join], config: Config) -> float:
    """Logarithm of how many poses of places of the second map in the first one chance could choose from [nats]."""
    area = MapArea(cell_m=config.sensor_range_m)
    area.cover_positions(first.graph.T_map_body[:, :2, 3])
    volume = max(log_volume(join.covariance) for join in joins)
    return float(np.log(len(second.graph.keyframe_ids)) + np.log(2.0 * np.pi * area.area_m2) - volume)


def judge_pairs(maps: Sequence[SavedMap], joins: Sequence[Join], config: Config) -> list[MapPair]:
    """One decision for each pair of maps of which a place was recognised in the other.

    Args:
        maps: condensed, by the numbers that the joins name.
        joins: of all of them.
        config: of the estimator.
    """
    of_pair = defaultdict[tuple[int, int], list[Join]](list)
    for join in joins:
        of_pair[join.reference_map, join.query_map].append(join)
    pairs = len(maps) * (len(maps) - 1) // 2
    min_log_odds = float(np.log(max(pairs, 1))) - float(logit(config.localization.error_probability))
    judged = []
    for (first, second), each in sorted(of_pair.items()):
        agree = _agreement(each, [maps[first], maps[second]], config)
        chosen, evidence, rival = _best_transform(each, agree)
        penalty = search_penalty(maps[first], maps[second], each, config)
        log_odds = float(evidence - penalty - np.logaddexp(0.0, rival - penalty))
        reason = ""
        if log_odds < min_log_odds:
            reason = f"posterior log odds {log_odds:.1f}, less than {min_log_odds:.1f}"
            if rival > penalty:
                reason += f"; another transform has a log-likelihood ratio of {rival:.1f} against {evidence:.1f}"
        agreed = tuple(join for join, is_chosen in zip(each, chosen.tolist(), strict=True) if is_chosen)
        judged.append(MapPair(first, second, agreed, log_odds, not reason, reason))
    return judged


def _best_transform(joins: Sequence[Join], agree: BoolArray) -> tuple[BoolArray, float, float]:
    """Which joins (J,) agree on the likeliest transform, and two log-likelihood ratios: that of this transform, and of
    the best other one for the same places.
    """
    places = np.unique([join.place for join in joins], return_inverse=True)[1]
    llrs = np.array([join.llr for join in joins])
    evidence = [_evidence(places[row], llrs[row]) for row in agree]
    best = int(np.argmax(evidence))
    chosen = agree[best]
    is_rival = ~chosen & np.isin(places, places[chosen])
    rivals = [_evidence(places[row & is_rival], llrs[row & is_rival]) for row in agree[is_rival]]
    return chosen, evidence[best], max(rivals, default=0.0)


def _evidence(places: IntArray, llrs: FloatArray) -> float:
    """Joint log-likelihood ratio of joins (J,) that agree: of each place the best."""
    best = np.zeros(int(places.max()) + 1)
    np.maximum.at(best, places, llrs)
    return float(max(best.max(), best.sum() / SHARING_PLACES))


def _agreement(joins: Sequence[Join], maps: Sequence[SavedMap], config: Config) -> BoolArray:
    """Which joins (J, J) tell one transform between two maps, as far as these may be bent."""
    T_first_second = np.array([join.T_reference_query for join in joins])
    at_first = np.array([join.T_reference_place[:3, 3] for join in joins])
    at_second = np.array([join.T_query_place[:3, 3] for join in joins])
    carried = np.einsum("iab,jb->ija", T_first_second[:, :3, :3], at_second) + T_first_second[:, None, :3, 3]
    apart_m = np.linalg.norm((carried - at_first)[..., :2], axis=-1)
    turned_rad = np.abs(yaw_rad(invert(T_first_second)[:, None] @ T_first_second))
    between_m = np.linalg.norm((at_first[:, None] - at_first)[..., :2], axis=-1)
    per_m, turn_per_m = np.sum([mean_drift(each) for each in maps], axis=0)
    turn_variance = turn_per_m * between_m + CLOSURE_SIGMA_RAD**2
    variance = per_m * between_m + turn_variance * between_m**2
    agrees = apart_m < AGREE_RANGES * config.sensor_range_m + GATE_SIGMAS * np.sqrt(variance)
    agrees &= turned_rad < AGREE_RAD + GATE_SIGMAS * np.sqrt(turn_variance)
    return np.asarray(agrees & agrees.T)


def mean_drift(condensed: SavedMap) -> tuple[float, float]:
    """Variances of the odometry on a metre of the drive: of the position [m^2 / m] and of the heading [rad^2 / m]."""
    is_driven = are_of_kind(condensed.graph, EdgeKind.ODOMETRY)
    travel_m = float(np.linalg.norm(condensed.graph.edge_transforms[is_driven, :3, 3], axis=1).sum())
    covariances = condensed.graph.edge_covariances[is_driven]
    if travel_m == 0.0:
        return 0.0, 0.0
    return float(covariances[:, 4, 4].sum()) / travel_m, float(covariances[:, 2, 2].sum()) / travel_m
