"""How near to one another detections of one object are."""

from dataclasses import replace

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.self_calibration.object_tracks import SurveyScan
from slam.self_calibration.resolution import _offsets_that_stay, find_resolution
from tests.helpers.surveyed_drives import NOISE, SurveyedDrive


@pytest.fixture(scope="module")
def scans() -> list[SurveyScan]:
    """Objects of which few are nearer to one another than 1.5 m, seen up to 15 m away."""
    return SurveyedDrive(0, NOISE, scans=300, objects=80).scans


def with_others(scans: list[SurveyScan], offsets: list[FloatArray]) -> list[SurveyScan]:
    """The scans with another detection at an offset (D, 3) from each."""
    return [
        replace(
            scan,
            positions=np.concatenate([scan.positions, scan.positions + offset]),
            labels=np.tile(scan.labels, 2),
            variances=np.tile(scan.variances, 2),
        )
        for scan, offset in zip(scans, offsets, strict=True)
    ]


def scattered(scans: list[SurveyScan], sigma_m: float) -> list[SurveyScan]:
    rng = np.random.default_rng(1)
    return with_others(scans, [rng.normal(0.0, sigma_m, scan.positions.shape) for scan in scans])


@pytest.mark.parametrize("sigma_m", [0.05, 0.2])
def test_second_detections_that_scatter_are_of_one_object(scans, sigma_m):
    assert 4.0 * sigma_m < find_resolution(scattered(scans, sigma_m)) < 1.5


def test_objects_that_are_detected_once_have_no_resolution(scans):
    assert find_resolution(scans) == 0.0
    assert find_resolution([]) == find_resolution(scans[:1]) == 0.0


@pytest.mark.parametrize("share", [1.0, 0.2])
def test_pairs_of_objects_keep_their_offset(scans, share):
    """Each has a neighbour to the east, at 0.3 m, in that share of the scans; in the others it scatters."""
    paired = round(share * len(scans))
    offsets = []
    for scan in scans[:paired]:
        R = scan.T_odom_body[:3, :3]
        offsets.append(np.tile(R.T @ [0.3, 0.0, 0.0], (len(scan.labels), 1)))
    both = with_others(scans[:paired], offsets) + scattered(scans[paired:], 0.1)
    assert find_resolution(both) == 0.0


@pytest.mark.parametrize(("labels", "stay"), [([0, 0], [True]), ([0, 1], [])])
def test_offsets_that_stay_are_those_between_detections_of_a_class(labels, stay):
    scan = SurveyScan(0, np.eye(4), np.array([[5.0, 0.0, 0.0], [5.5, 0.0, 0.0]]), np.array(labels), np.zeros(2))
    assert _offsets_that_stay([scan, scan], 2.0).tolist() == stay


def test_a_scan_of_many_detections_is_left_out(scans):
    twice = scattered(scans, 0.1)
    heap = replace(scans[0], positions=np.zeros((30_000, 3)), labels=np.zeros(30_000, int))
    assert find_resolution([heap, *twice, heap]) == find_resolution(twice) > 0.0


def test_few_pairs_tell_nothing(scans):
    """Three objects in each of ten scans."""
    few = [replace(s, positions=s.positions[:3], labels=s.labels[:3], variances=s.variances[:3]) for s in scans[:10]]
    assert find_resolution(scattered(few, 0.1)) == 0.0


def test_a_body_that_moves_by_more_than_the_resolution_tells_it(scans):
    """By 1.2 m from scan to scan."""
    assert find_resolution(scattered(scans[:150:4], 0.05)) > 0.2
