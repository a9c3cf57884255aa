"""Detections that are of another time than their stamps say, a sensor that is turned, and an odometry that lacks a
climb: what brings the detections of scans nearest to one another.

The terms are found one after another, the one that explains most first, each by a search from what was found so far. If
lengths or turns of the odometry that are wrong by a share, or a sensor that sits elsewhere, explain more, no further
term but a climb is found: over pairs of scans all these look much the same, and objects that are followed tell them
apart.
"""

from collections.abc import Callable, Sequence

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration
from slam.common.geometry import rotation_of, transform_from_xyz_yaw, yaw_rad
from slam.self_calibration.scan_pairs import ScanPairs, evidence, is_better, seen_by, spacing_of
from slam.self_calibration.surveyed_log import SurveyedLog

ANGLES = "roll_rad", "pitch_rad", "yaw_rad"
MIN_VALUES = {"delay_s": 0.0} | dict.fromkeys(ANGLES, 0.09) | {"climb_share": 0.005}
"""Terms, and what they must exceed to be corrected: less of an angle may be the road's."""
RIVALS = "length_share", "turn_share", "x_spacings", "y_spacings"
"""Other terms that may explain more; shifts of the sensor are in spacings of the objects."""
FACTORS = dict.fromkeys(MIN_VALUES, 1.03) | {"climb_share": 1.0}
"""By which a term must increase the evidence. A climb explains little of how objects seem to move, but adds up."""
FIRST_STEP, COARSE, FINE = 0.25, 5, 9
"""The first step of a search, as a share of the median time between the scans of pairs, of 1 rad, or of the way; how
often it is halved until it is known whether the term matters, and after all.
"""
ROUNDS = 10

_Values = dict[str, float]


def find_alignment(
    logs: Sequence[SurveyedLog], calibration: Calibration, terms: Sequence[str]
) -> tuple[_Values, _Values]:
    """Values of the ``terms``, of those of ``MIN_VALUES``, on top of what the calibration corrects: those to be
    corrected, and others that bring scans nearer to one another but are too small.

    ``delay_s``: by how much detections are of a later time than their stamps say; the angles: a rotation vector of the
    detections in the axes of the body; ``climb_share``: height that the odometry lacks, by the way.
    """
    distances, seconds = _compared(logs, calibration)
    values, suspected = dict.fromkeys([*MIN_VALUES, *RIVALS], 0.0), _Values()

    def better(candidates: Sequence[str]) -> dict[str, _Values]:
        """What raises the evidence, by term."""
        found, now = {}, distances(values)
        for term in candidates:
            factor, each = FACTORS.get(term, 1.0), values
            step = FIRST_STEP * (seconds if term == "delay_s" else 1.0)
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
        motions = transform_from_xyz_yaw(shares[0] * motions[:, :3, 3], shares[1] * yaw_rad(motions))
        motions[:, 2, 3] += values["climb_share"] * np.linalg.norm(motions[:, :2, 3], axis=1)
        T_body_sensor = np.eye(4)
        T_body_sensor[:3, :3] = rotation_of(np.array([values[angle] for angle in ANGLES]))
        T_body_sensor[:2, 3] = pairs[number].spacing_m * np.array([values["x_spacings"], values["y_spacings"]])
        return pairs[number].log_distances(seen_by(T_body_sensor, motions))

    def distances(values: _Values) -> FloatArray:
        return np.concatenate([np.zeros((0, 2)), *(of_log(number, values) for number in range(len(pairs)))])

    return distances, float(np.median(np.concatenate([np.ones(1), *seconds])))
