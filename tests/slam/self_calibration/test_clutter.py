"""How densely detections lie that are of no object."""

import numpy as np
import pytest

from slam.self_calibration.object_tracks import SurveyScan
from slam.self_calibration.survey import clutter_density


def scans_of(each: float, *, half_angle: float = np.pi, height_m: float = 0.0) -> list:
    """Scans with so many detections, evenly over a view of 25 m and a layer of that height."""
    rng = np.random.default_rng(0)
    scans = []
    for number, count in enumerate(rng.poisson(each, 300).tolist()):
        r, angle = 25.0 * np.sqrt(rng.random(count)), half_angle * rng.uniform(-1.0, 1.0, count)
        z = height_m * rng.random(count)
        positions, labels = np.column_stack([r * np.cos(angle), r * np.sin(angle), z]), np.zeros(count, int)
        scans.append(SurveyScan(number, np.eye(4), positions, labels, np.full(count, np.nan)))
    return scans


@pytest.mark.parametrize(("each", "half_angle"), [(45.0, np.pi), (200.0, np.pi), (60.0, 0.7)])
def test_the_density_is_that_of_what_is_not_tracked(each, half_angle):
    scans = scans_of(each, half_angle=half_angle, height_m=4.0)
    count = sum(len(scan.positions) for scan in scans)
    layer_m = 4.0 * np.sqrt(2.0 * np.pi * np.e / 12.0)  # of a Gaussian with the same variance
    assert clutter_density(scans, count // 4, 0.0) == pytest.approx(
        0.75 * each / (half_angle * 25.0**2 * layer_m), rel=0.2
    )


def test_detections_of_one_height_are_spread_by_their_noise():
    scans = scans_of(45.0)
    thin, thick = (clutter_density(scans, 0, sigma_m) for sigma_m in (0.1, 0.2))
    assert thin == pytest.approx(2.0 * thick)
    assert clutter_density(scans, 0, 0.0) == 0.0, "no volume to tell a density of"
