"""The unit of the odometry's lengths, if it is not that of the detections.

Between two scans, the right lengths bring the detections nearer to one another than the inverse motion does. With
lengths that are too long by far, both are as wrong; with lengths that are too short, the scans that are a part of the
spacing of the objects apart share no object. So the evidence has one maximum, at the right octave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam.common.arrays import FloatArray
from slam.self_calibration.object_tracks import SurveyScan
from slam.self_calibration.scan_pairs import ScanPairs, evidence, is_positive, spacing_of

OCTAVES = 20
"""Factors of up to two to that power are tried, a million either way."""
NEARER = 1.25
"""By so much, at least, the right lengths bring scans nearer than the inverse motion does; in wrong axes, some lengths
do so by a tenth.
"""


def is_unit_right(scans: Sequence[SurveyScan]) -> bool:
    """Whether the travel of the odometry brings scans (K), in the order of their stamps, nearer to one another than its
    inverse does.
    """
    return len(scans) > 1 and is_positive(_evidence(scans, spacing_of(scans)))


def find_unit(scans: Sequence[SurveyScan]) -> float:
    """The power of two by which lengths of the odometry must be multiplied; 1 where no other one is sure.

    ``scans``: (K) in the order of their stamps.
    """
    if len(scans) < 2:
        return 1.0
    spacing_m, factors = spacing_of(scans), 2.0 ** np.arange(-OCTAVES, OCTAVES + 1)
    found = [_evidence(scans, spacing_m, factor) for factor in factors.tolist()]
    best = int(np.argmax([np.sum(each) for each in found]))
    is_sure = is_positive(found[best]) and np.mean(found[best]) > np.log(NEARER)
    return float(factors[best]) if is_sure else 1.0


def _evidence(scans: Sequence[SurveyScan], spacing_m: float, factor: float = 1.0) -> FloatArray:
    """Evidence (P,) of pairs of scans, where the lengths of the odometry are multiplied by a factor."""
    pairs = ScanPairs.by_travel(
        [replace(scan, T_odom_body=_scaled(scan.T_odom_body, factor)) for scan in scans], spacing_m
    )
    return evidence(pairs.log_distances(pairs.motions))


def _scaled(T: FloatArray, factor: float) -> FloatArray:
    T = T.copy()
    T[:3, 3] *= factor
    return T
