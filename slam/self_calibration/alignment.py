"""Detections that are of another time than their stamps say, a sensor that is turned, and an odometry that lacks a
climb or whose heading drifts: what brings the detections of scans nearest to one another.

The terms are found one after another, the one that explains most first, each by a search from what was found so far. If
lengths or turns of the odometry that are wrong by a share, or a sensor that sits elsewhere, explain more, no further
term but a climb is found: over pairs of scans all these look much the same, and objects that are followed tell them
apart. Over them a climb also looks like the pitch of a sensor, and a drift like its yaw: that is corrected for which
there is more evidence, by the factor of the term, when all other terms are fitted beside it. A climb that is less steep
than the least angle that is corrected stays.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration
from slam.common.geometry import rotation_of, transform_from_xyz_yaw, yaw_rad
from slam.self_calibration.scan_pairs import ScanPairs, evidence, is_better, spacing_of
from slam.self_calibration.surveyed_log import SurveyedLog

ANGLES = "roll_rad", "pitch_rad", "yaw_rad"
MIN_VALUES = {"delay_s": 0.0, "drift_rad_per_s": 0.0} | dict.fromkeys(ANGLES, 0.09) | {"climb_share": 0.005}
"""Terms, and what they must exceed to be corrected: less of an angle may be the road's."""
RIVALS = "length_share", "turn_share", "x_spacings", "y_spacings"
"""Other terms that may explain more; shifts of the sensor are in spacings of the objects."""
FACTORS = dict.fromkeys(MIN_VALUES, 1.03) | {"climb_share": 1.0}
"""By which a term must increase the evidence. A climb explains little of how objects seem to move, but adds up."""
BOUNDED = {"climb_share": "pitch_rad", "drift_rad_per_s": "yaw_rad"}
"""Terms that lead away from the ground, or turn the body, all the way, and the angles of a sensor that look like them
over pairs of scans.
"""
FIRST_STEP, COARSE, FINE = 0.25, 5, 9
"""The first step of a search, as a share of the median time between the scans of pairs, of 1 rad, also over that time,
or of the way; how often it is halved until it is known whether the term matters, and after all.
"""
ROUNDS = 10

_Values = dict[str, float]


def find_alignment(
    logs: Sequence[SurveyedLog], calibration: Calibration, terms: Sequence[str]
) -> tuple[_Values, _Values]:
    """Values of the ``terms``, of those of ``MIN_VALUES``, on top of what the calibration corrects: those to be
    corrected, and others that bring scans nearer to one another but are too small.

    ``delay_s``: by how much detections are of a later time than their stamps say; ``drift_rad_per_s``: turn that the
    odometry lacks, by the time; the angles: a rotation vector of the detections in the axes of the body;
    ``climb_share``: height that the odometry lacks, by the way.
    """
    distances, seconds = _compared(logs, calibration)
    values, suspected = dict.fromkeys([*MIN_VALUES, *RIVALS], 0.0), _Values()

    def better(candidates: Sequence[str]) -> dict[str, _Values]:
        """What raises the evidence, by term."""
        found, now = {}, distances(values)
        for term in candidates:
            factor, each = FACTORS.get(term, 1.0), values
            step = _first_step(term, seconds)
            for first, last in ((0, COARSE), (COARSE + 1, FINE)):
                each = _search(distances, each, term, step / 2**first, last - first)
                if not is_better(distances(each), now, factor):
                    break
            else:
                found[term] = each
        return found

    for _ in range(ROUNDS):
        found = better(terms)
        large = {term: each for term, each in found.items() if values[term] or abs(each[term]) > MIN_VALUES[term]}
        suspected = {term: each[term] for term, each in found.items() if term not in large}
        explaining = large | better(RIVALS) if large else {}
        nearest = min(explaining, key=lambda term: np.sum(distances(explaining[term])[:, 0]), default="")
        if nearest in RIVALS:
            nearest = "climb_share"  # which looks like none of them
        if nearest not in large:
            break
        values = large[nearest]
    for term, bounded in BOUNDED.items():
        if bounded in terms and abs(values[term]) > (MIN_VALUES[bounded] if term == "climb_share" else 0.0):
            others = [each for each in values if each not in (term, bounded)]
            growing = _best(distances, values, others, seconds)
            steady = _best(distances, values | {term: 0.0}, [bounded, *others], seconds)
            for_term, for_angle = (np.sum(evidence(distances(each))) for each in (growing, steady))
            if for_term <= FACTORS[term] * for_angle:
                angle = steady[bounded]
                values |= {term: 0.0, bounded: angle if abs(angle) > MIN_VALUES[bounded] else 0.0}
    return {term: value for term, value in values.items() if value}, suspected


def _best(distances: Callable[[_Values], FloatArray], values: _Values, terms: Sequence[str], seconds: float) -> _Values:
    """The values with those of the terms for which there is most evidence, one after the other, and again."""
    for _ in range(2):
        for term in terms:
            values = _search(distances, values, term, _first_step(term, seconds), COARSE)
    return values


def _first_step(term: str, seconds: float) -> float:
    """The first step of a search, with the median time between the scans of pairs."""
    return FIRST_STEP * {"delay_s": seconds, "drift_rad_per_s": 1.0 / max(seconds, 1e-9)}.get(term, 1.0)


def _search(
    distances: Callable[[_Values], FloatArray], start: _Values, term: str, step: float, halvings: int
) -> _Values:
    """The values with the one of the term for which there is most evidence, uphill from ``start``."""
    tried = {start[term]: np.sum(evidence(distances(start)))}
    best = start[term]
    for _ in range(1 + halvings):
        centre = np.nan
        while centre != best:
            centre = best
            for value in (centre - step, centre + step):
                if value not in tried:
                    tried[value] = np.sum(evidence(distances(start | {term: value})))
                best = max(best, value, key=tried.__getitem__)
        step /= 2.0
    return start | {term: best} if best != start[term] else start


def _compared(logs: Sequence[SurveyedLog], calibration: Calibration) -> tuple[Callable[[_Values], FloatArray], float]:
    """A function that gives the log distances (P, 2) of pairs of scans for values of the terms, and the median time [s]
    between the scans of pairs.
    """
    surveyed = [(log, scans) for log in logs if len(scans := log.scans(calibration, {})[0]) > 1]
    pairs = [ScanPairs.of(scans, spacing_of(scans), fastest=False) for _, scans in surveyed]
    stamps = [np.array([scan.stamp_ns for scan in scans]) for _, scans in surveyed]
    seconds = [np.diff(each[found.rows])[:, 0] * 1e-9 for each, found in zip(stamps, pairs, strict=True)]

    def of_log(number: int, values: _Values) -> FloatArray:
        T_odom_body = surveyed[number][0].poses_at(stamps[number], calibration, values["delay_s"])
        motions = pairs[number].motions_by(T_odom_body)
        shares = 1.0 + values["length_share"], 1.0 + values["turn_share"]
        turns = shares[1] * yaw_rad(motions) + values["drift_rad_per_s"] * seconds[number]
        motions = transform_from_xyz_yaw(shares[0] * motions[:, :3, 3], turns)
        motions[:, 2, 3] += values["climb_share"] * np.linalg.norm(motions[:, :2, 3], axis=1)
        T_body_sensor = np.eye(4)
        T_body_sensor[:3, :3] = rotation_of(np.array([values[angle] for angle in ANGLES]))
        T_body_sensor[:2, 3] = pairs[number].spacing_m * np.array([values["x_spacings"], values["y_spacings"]])
        return pairs[number].log_distances(pairs[number].seen_by(T_body_sensor, motions))

    @lru_cache  # searches of all terms begin at the same values, and end at those that are judged
    def of_logs(items: frozenset[tuple[str, float]]) -> FloatArray:
        values = dict(items)
        return np.concatenate([np.zeros((0, 2)), *(of_log(number, values) for number in range(len(pairs)))])

    median_s = float(np.median(np.concatenate([np.ones(1), *seconds])))
    return lambda values: of_logs(frozenset(values.items())), median_s
