"""Detections that are of another time than their stamps say, a sensor that is turned, and an odometry that lacks a
climb or a turn, by the time or by the way: what brings the detections of scans nearest to one another.

The terms are found one after another, the one that explains most first, each by a search from what was found so far. If
lengths or turns of the odometry that are wrong by a share, or a sensor that sits elsewhere, explain more, no further
term but a climb is found: over pairs of scans all these look much the same, and objects that are followed tell them
apart. They also tell a climb from the pitch of a sensor, and a turn from its yaw.
"""

from collections.abc import Callable, Collection, Sequence
from functools import lru_cache

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration
from slam.common.geometry import make_transform, rotation_of, transform_from_xyz_yaw, yaw_rad
from slam.self_calibration.scan_pairs import ScanPairs, evidence, is_better, spacing_of
from slam.self_calibration.surveyed_log import SurveyedLog

ANGLES = "roll_rad", "pitch_rad", "yaw_rad"
GROWING = {"pitch_rad": ("climb_share",), "yaw_rad": ("drift_rad_per_s", "curvature_rad_per_m")}
"""Terms whose effect grows all the way, by the angle of a sensor that looks like them over pairs of scans."""
MIN_VALUES = dict.fromkeys(("delay_s", *GROWING["yaw_rad"]), 0.0) | dict.fromkeys(ANGLES, 0.09) | {"climb_share": 0.005}
"""Terms, and what they must exceed to be corrected: less of an angle may be the road's."""
RIVALS = "length_share", "turn_share", "x_spacings", "y_spacings"
"""Other terms that may explain more; shifts of the sensor are in spacings of the objects."""
FACTORS = dict.fromkeys(("delay_s", *ANGLES), 1.03)
"""By which a term must increase the evidence. What grows explains little of how objects seem to move, but adds up."""
FIRST_STEP, COARSE, FINE = 0.25, 5, 9
"""The first step of a search, as a share of the median time between the scans of pairs, of 1 rad, also over that time,
or of the way; how often it is halved until it is known whether the term matters, and after all.
"""
ROUNDS = 10

_Values = dict[str, float]


def find_alignment(
    logs: Sequence[SurveyedLog], calibration: Calibration, terms: Collection[str]
) -> tuple[_Values, _Values]:
    """Values of the ``terms``, of those of ``MIN_VALUES``, on top of what the calibration corrects: those to be
    corrected, and others that bring scans nearer to one another but are too small.

    ``delay_s``: by how much detections are of a later time than their stamps say; ``drift_rad_per_s`` and
    ``curvature_rad_per_m``: turn that the odometry lacks, by the time and by the way; the angles: a rotation vector of
    the detections in the axes of the body; ``climb_share``: height that the odometry lacks, by the way.
    """
    distances, steps = _compared(logs, calibration)
    values, suspected = dict.fromkeys([*MIN_VALUES, *RIVALS], 0.0), _Values()

    def better(candidates: Collection[str]) -> dict[str, _Values]:
        """What raises the evidence, by term."""
        found, now = {}, distances(values)
        for term in candidates:
            factor, each = FACTORS.get(term, 1.0), values
            for first, last in ((0, COARSE), (COARSE + 1, FINE)):
                each = _search(distances, each, term, steps[term] / 2**first, last - first)
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
    return {term: value for term, value in values.items() if value}, suspected


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


def _compared(logs: Sequence[SurveyedLog], calibration: Calibration) -> tuple[Callable[[_Values], FloatArray], _Values]:
    """A function that gives the log distances (P, 2) of pairs of scans for values of the terms, and the first step of a
    search for each term, by the median time and way between the scans of pairs.
    """
    surveyed = [(log, *found) for log in logs if len((found := log.scans(calibration, {}))[0]) > 1]
    pairs = [ScanPairs.of(scans, spacing_of(scans), fastest=False) for _, scans, _ in surveyed]
    stamps = [np.array([scan.stamp_ns for scan in scans]) for _, scans, _ in surveyed]
    grown = [
        np.diff(np.stack([motion.seconds, motion.travels])[:, each.rows])[..., 0]
        for each, (_, _, motion) in zip(pairs, surveyed, strict=True)
    ]

    def of_log(number: int, values: _Values) -> FloatArray:
        T_odom_body = surveyed[number][0].poses_at(stamps[number], calibration, values["delay_s"])
        motions = pairs[number].motions_by(T_odom_body)
        shares = 1.0 + values["length_share"], 1.0 + values["turn_share"]
        turns = shares[1] * yaw_rad(motions) + np.array([values[term] for term in GROWING["yaw_rad"]]) @ grown[number]
        motions = transform_from_xyz_yaw(shares[0] * motions[:, :3, 3], turns)
        motions[:, 2, 3] += values["climb_share"] * np.linalg.norm(motions[:, :2, 3], axis=1)
        shift_m = pairs[number].spacing_m * np.array([values["x_spacings"], values["y_spacings"], 0.0])
        T_body_sensor = make_transform(rotation_of(np.array([values[angle] for angle in ANGLES])), shift_m)
        return pairs[number].log_distances(pairs[number].seen_by(T_body_sensor, motions))

    @lru_cache  # searches of all terms begin at the same values, and end at those that are judged
    def of_logs(items: frozenset[tuple[str, float]]) -> FloatArray:
        values = dict(items)
        return np.concatenate([np.zeros((0, 2)), *(of_log(number, values) for number in range(len(pairs)))])

    medians = np.median(np.concatenate([np.ones((2, 1)), *grown], axis=1), axis=1)
    second, metre = (1.0 / np.maximum(medians, 1e-9)).tolist()
    steps = dict.fromkeys([*MIN_VALUES, *RIVALS], FIRST_STEP)
    steps |= {"delay_s": FIRST_STEP / second, "drift_rad_per_s": FIRST_STEP * second}
    steps["curvature_rad_per_m"] = FIRST_STEP * metre
    return lambda values: of_logs(frozenset(values.items())), steps
