"""How densely detections lie that are of no object that stands still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.self_calibration.object_tracks import SurveyScan, nearest_of_class_m


def clutter_density(scans: Sequence[SurveyScan], tracked: int, sigma_m: float) -> float:
    """Density [1/m^3], as association sees it, of the detections of scans (one at least) that are of no object: all but
    so many that are ``tracked``, with noise ``sigma_m``.

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
    return float(share / (area_m2 * height_m)) if is_known else 0.0
