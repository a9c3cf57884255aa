"""Detections that are of another time than their stamps say, a sensor that is turned, and an odometry that lacks a
climb: what brings the detections of scans nearest to one another.

The terms are found one after another, the one that explains most first, each by a search from what was found so far. If
lengths or turns of the odometry that are wrong by a share, or a sensor that sits elsewhere, explain more, no further
term is found: over pairs of scans all these look much the same, and objects that are followed tell them apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration
from slam.common.geometry import transform_from_xyz_yaw, yaw_rad
from slam.self_calibration.scan_pairs import ScanPairs, evidence, is_better, seen_by, spacing_of
from slam.self_calibration.surveyed_log import SurveyedLog

ANGLES = "roll_rad", "pitch_rad", "yaw_rad"
MIN_VALUES = {"delay_s": 0.0} | dict.fromkeys(ANGLES, 0.09) | {"climb_share": 0.005}
"""Terms, and what they must exceed to be corrected: less of an angle may be the road's."""
RIVALS = "length_share", "turn_share", "x_spacings", "y_spacings"
"""Other terms that may explain more; shifts of the sensor are in spacings of the objects."""
FACTORS = dict.fromkeys(MIN_VALUES, 1.03) | {"climb_share": 1.0}
"""By which a term must increase the evidence. A climb explains little of how objects seem to move, but adds up."""
COARSE, HALVINGS = 0.25, 9
"""The first step of a search, as a share of the median time between the scans of pairs, of 1 rad, or of the way; how
often it is halved.
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
    for _ in range(ROUNDS):
        before = distances(values)
        better = {}
        for term in [*terms, *RIVALS]:
            found = _search(distances, values, term, COARSE * (seconds if term == "delay_s" else 1.0))
            if is_better(distances(found), before, FACTORS.get(term, 1.0)):
                better[term] = found
        small = {term: found for term, found in better.items() if _is_small(term, values[term], found[term])}
        suspected = {term: found[term] for term, found in small.items()}
        large = better.keys() - small.keys()
        best = min(large, key=lambda term: float(np.sum(distances(better[term])[:, 0])), default=RIVALS[0])
        if best in RIVALS:
            break
        values = better[best]
    return {term: value for term, value in values.items() if value}, suspected


def _is_small(term: str, before: float, found: float) -> bool:
    """Whether a term that was not found before is too small to be corrected."""
    return before == 0.0 and abs(found) <= MIN_VALUES.get(term, 0.0)


def _search(distances: Callable[[_Values], FloatArray], start: _Values, term: str, step: float) -> _Values:
    """The values with the one of the term for which there is most evidence, uphill from ``start``."""
    best = start
    for _ in range(1 + HALVINGS):
        centre = None
        while centre is not best:
            centre = best
            for change in (-step, step):
                other = centre | {term: centre[term] + change}
                if np.sum(evidence(distances(other))) > np.sum(evidence(distances(best))):
                    best = other
        step /= 2.0
    return best


def _compared(logs: Sequence[SurveyedLog], calibration: Calibration) -> tuple[Callable[[_Values], FloatArray], float]:
    """A function that gives the log distances (P, 2) of pairs of scans for values of the terms, and the median time [s]
    between the scans of pairs.
    """
    surveyed = [(log, scans) for log in logs if len(scans := log.scans(calibration, {})[0]) > 1]
    pairs = [ScanPairs.of(scans, spacing_of(scans), fastest=False) for _, scans in surveyed]
    stamps = [np.array([scan.stamp_ns for scan in scans]) for _, scans in surveyed]
    seconds = [np.diff(each[found.rows])[:, 0] * 1e-9 for each, found in zip(stamps, pairs, strict=True)]
    known = dict[tuple[float, ...], FloatArray]()

    def of_log(number: int, values: _Values) -> FloatArray:
        T_odom_body = surveyed[number][0].poses_at(stamps[number], calibration, values["delay_s"])
        motions = pairs[number].motions_by(T_odom_body)
        shares = 1.0 + values["length_share"], 1.0 + values["turn_share"]
        motions = transform_from_xyz_yaw(shares[0] * motions[:, :3, 3], shares[1] * yaw_rad(motions))
        motions[:, 2, 3] += values["climb_share"] * np.linalg.norm(motions[:, :2, 3], axis=1)
        T_body_sensor = np.eye(4)
        T_body_sensor[:3, :3] = Rotation.from_rotvec([values[angle] for angle in ANGLES]).as_matrix()
        T_body_sensor[:2, 3] = pairs[number].spacing_m * np.array([values["x_spacings"], values["y_spacings"]])
        return pairs[number].log_distances(seen_by(T_body_sensor, motions))

    def distances(values: _Values) -> FloatArray:
        key = tuple(values.values())
        if key not in known:
            known[key] = np.concatenate([np.zeros((0, 2)), *(of_log(number, values) for number in range(len(pairs)))])
        return known[key]

    return distances, float(np.median(np.concatenate([np.ones(1), *seconds])))
