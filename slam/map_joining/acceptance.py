"""Which maps are joined: all recognised places of two maps have to tell one transform between them.

A single place can be like another one by chance, and a row of trees like its neighbour. Places along a drive that are
recognised at one transform can hardly be: their log-likelihood ratios add up to that of the transform, L. Its posterior
odds, against the best other transform for the same places, L', and "the maps have no place in common", are

    log o = (L - log n) - log(1 + exp(L' - log n)),

where n is the number of places that chance could choose from. Two maps are joined if they are wrong with a probability
below ``localization.error_probability``, shared among all pairs of maps: a false join bends everything on both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray
from slam.common.config import Config
from slam.common.geometry import invert, yaw_rad
from slam.localization.localizer import log_odds_of
from slam.loop_closure.consistency import AGREE_RAD, AGREE_RANGES, CLOSURE_SIGMA_RAD
from slam.map_joining.joins import Join, mean_drift
from slam.object_map.map_io import SavedMap

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
    def best(self) -> Join:
        """The join with the highest log-likelihood ratio."""
        return max(self.joins, key=lambda join: (join.llr, -join.query_map, -join.place))


def search_penalty(maps: Sequence[SavedMap]) -> float:
    """Logarithm of how many places of these maps chance could choose from [nats]."""
    places = sum(len(each.graph.keyframe_ids) for each in maps)
    return float(np.log(max(places, sum(len(each.objects.ids) for each in maps), 1)))


def judge_pairs(
    maps: Sequence[SavedMap], joins: Sequence[Join], config: Config, *, penalty: float | None = None
) -> list[MapPair]:
    """One verdict for each pair of maps of which a place was recognised in the other.

    Args:
        maps: condensed, by the numbers that the joins name.
        joins: of all of them.
        config: of the estimator.
        penalty: in place of the ``search_penalty`` of the maps.
    """
    of_pair: dict[tuple[int, int], list[Join]] = {}
    for join in sorted(joins, key=lambda join: (join.query_map, join.place, join.reference_map, -join.llr)):
        of_pair.setdefault(_pair(join), []).append(join)
    penalty = search_penalty(maps) if penalty is None else penalty
    pairs = len(maps) * (len(maps) - 1) // 2
    least_log_odds = float(np.log(max(pairs, 1))) - log_odds_of(config.localization.error_probability)
    return [
        _judge(pair, np.array(each, dtype=object), maps, config, penalty, least_log_odds)
        for pair, each in sorted(of_pair.items())
    ]


def _judge(
    pair: tuple[int, int],
    joins: np.ndarray,
    maps: Sequence[SavedMap],
    config: Config,
    penalty: float,
    least_log_odds: float,
) -> MapPair:
    agree = _agreement(joins, maps, config)
    evidence = [_evidence(joins[row]) for row in agree]
    best = int(np.argmax(evidence))
    chosen = agree[best]
    asked = {(join.query_map, join.place) for join in joins[chosen]}
    rivals = ~chosen & np.array([(join.query_map, join.place) in asked for join in joins])
    rival_llr = max((_evidence(joins[agree[row] & rivals]) for row in np.flatnonzero(rivals)), default=0.0)
    log_odds = float(evidence[best] - penalty - np.logaddexp(0.0, rival_llr - penalty))
    accepted = bool(log_odds >= least_log_odds)
    doubt = f"posterior log odds {log_odds:.1f}, less than {least_log_odds:.1f}"
    against = f"; another transform has a log-likelihood ratio of {rival_llr:.1f} against {evidence[best]:.1f}"
    reason = "" if accepted else doubt + (against if rival_llr > penalty else "")
    return MapPair(*pair, tuple(joins[chosen].tolist()), log_odds, accepted, reason)


def _evidence(joins: np.ndarray) -> float:
    """Joint log-likelihood ratio of joins that agree: of each place the best."""
    best: dict[tuple[int, int], float] = {}
    for join in joins:
        key = (join.query_map, join.place)
        best[key] = max(best.get(key, 0.0), join.llr)
    values = list(best.values())
    return max([*values, sum(values) / SHARING_PLACES], default=0.0)


def _agreement(joins: np.ndarray, maps: Sequence[SavedMap], config: Config) -> BoolArray:
    """Which joins (J, J) tell one transform between the two maps, as far as these may be bent."""
    first = _pair(joins[0])[0]
    T_first_second, places_first, places_second = [], [], []
    for join in joins:
        T_map_place = maps[join.query_map].graph.T_map_body[join.place]
        T_reference_query = join.T_reference_place @ invert(T_map_place)
        is_query = join.query_map == first
        T_first_second.append(invert(T_reference_query) if is_query else T_reference_query)
        places_first.append((T_map_place if is_query else join.T_reference_place)[:3, 3])
        places_second.append((join.T_reference_place if is_query else T_map_place)[:3, 3])
    T, at_first, at_second = np.array(T_first_second), np.array(places_first), np.array(places_second)
    carried = np.einsum("iab,jb->ija", T[:, :3, :3], at_second) + T[:, None, :3, 3]
    apart_m = np.hypot(carried[..., 0] - at_first[None, :, 0], carried[..., 1] - at_first[None, :, 1])
    turned = yaw_rad(invert(T)[:, None] @ T[None])
    between_m = np.hypot(*(at_first[:, None, :2] - at_first[None, :, :2]).transpose(2, 0, 1))
    limit_m, limit_rad = _tolerances(between_m, [maps[number] for number in _pair(joins[0])], config)
    agrees = (apart_m < limit_m) & (np.abs(turned) < limit_rad)
    return np.asarray(agrees & agrees.T)


def _tolerances(between_m: FloatArray, maps: Sequence[SavedMap], config: Config) -> tuple[FloatArray, FloatArray]:
    """How far [m] and turned [rad] two joins may be apart over distances (J, J)."""
    drifts = [mean_drift(each) for each in maps]
    per_m, turn_per_m = sum(drift for drift, _ in drifts), sum(turn for _, turn in drifts)
    turn_variance = turn_per_m * between_m + CLOSURE_SIGMA_RAD**2
    variance = per_m * between_m + turn_variance * between_m**2
    base_m = AGREE_RANGES * config.sensor_range_m
    return base_m + GATE_SIGMAS * np.sqrt(variance), AGREE_RAD + GATE_SIGMAS * np.sqrt(turn_variance)


def _pair(join: Join) -> tuple[int, int]:
    return min(join.query_map, join.reference_map), max(join.query_map, join.reference_map)
