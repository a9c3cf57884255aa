"""Share and density of the detections that are not of static objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam.self_calibration.object_tracks import SurveyScan, nearest_of_class_m


@dataclass(frozen=True, slots=True)
class Clutter:
    """``share`` of the detections that belong to no track of an object, ``per_scan`` their mean number; ``per_m3``:
    their density [1/m^3] as association sees it, which spreads detections of one height by their noise.
    """

    share: float = 0.0
    per_scan: float = 0.0
    per_m3: float = 0.0


def measure_clutter(scans: Sequence[SurveyScan], tracked: int, sigma_m: float) -> Clutter:
    """The clutter of scans (one at least) of whose detections so many are ``tracked``, with noise ``sigma_m``.

    Where points lie at random with a density d, the nearest one is farther than r with the probability
    exp(-pi d r^2), for any field of view; half of them are farther than the median.
    """
    heights = np.concatenate([scan.positions[:, 2] for scan in scans])
    nearest_m = [nearest_of_class_m(scan.positions[:, :2], np.zeros_like(scan.labels)) for scan in scans]
    median_m = float(np.median(np.concatenate(nearest_m)))
    share = 1.0 - tracked / len(heights)
    # The width of an even distribution with the entropy of a Gaussian; a detection and a landmark both err.
    height_m = np.sqrt(2.0 * np.pi * np.e * (np.var(heights) + 2.0 * sigma_m**2))
    area_m2 = np.pi * median_m**2 / np.log(2.0)
    is_known = 0.0 < median_m < np.inf and height_m > 0.0
    per_m3 = share / (area_m2 * height_m) if is_known else 0.0
    return Clutter(share, share * len(heights) / len(scans), float(per_m3))
