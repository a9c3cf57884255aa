"""Pairs of scans: which there are, and how near the motion of the body brings their detections to one another."""

from dataclasses import replace

import numpy as np
import pytest

from slam.common.geometry import apply, invert, yaw_rad
from slam.self_calibration.scan_pairs import RESOLVED_SPACINGS, ScanPairs, _evenly, _reached, is_better, spacing_of
from tests.helpers.poses import motion_by
from tests.helpers.surveyed_drives import NOISE, SurveyedDrive


def test_distances_are_those_of_the_nearest_of_the_class_by_the_motion_and_by_its_inverse(drive):
    rng = np.random.default_rng(0)
    scans = [replace(scan, labels=rng.integers(0, 3, len(scan.labels))) for scan in drive.scans[:40]]
    rows, spacing_m = np.array([[0, 7], [3, 30], [7, 3]]), 2.5
    expected = np.zeros((3, 2))
    poses = [scan.T_odom_body for scan in scans]  # upright
    for row, (i, j) in enumerate(rows):
        motion = invert(poses[i]) @ poses[j]
        for column, T in enumerate((motion, invert(motion))):
            apart = np.linalg.norm(apply(T, scans[j].positions)[:, None] - scans[i].positions, axis=2)
            apart[scans[j].labels[:, None] != scans[i].labels] = np.inf
            nearest = np.minimum(apart.min(axis=1), spacing_m)
            expected[row, column] = np.mean(np.log(np.hypot(nearest, RESOLVED_SPACINGS * spacing_m)))
    pairs = ScanPairs(scans, rows, spacing_m)
    np.testing.assert_allclose(pairs.log_distances(pairs.motions), expected, atol=1e-9)


def test_motions_have_no_roll_and_pitch(drive):
    pairs = ScanPairs.of(drive.scans, spacing_of(drive.scans))
    tilted = np.stack([scan.T_odom_body @ motion_by([0.2, -0.1, 0.0]) for scan in drive.scans])
    np.testing.assert_allclose(pairs.motions_by(tilted)[:, 2], [[0.0, 0.0, 1.0, 0.0]] * len(pairs.rows), atol=1e-9)


NONE, NEARER = np.zeros((400, 2)), np.tile([-1.0, 0.0], (400, 1))
CHANCE = np.random.default_rng(0).normal(size=(400, 2)) * [1.0, 0.0]


@pytest.mark.parametrize(
    ("distances", "now", "factor", "expected"),
    [
        pytest.param(CHANCE + 0.5 * NEARER, NONE, 1.0, True, id="more than chance"),
        pytest.param(CHANCE - CHANCE.mean(axis=0), NONE, 1.0, False, id="chance"),
        pytest.param(np.repeat(CHANCE[:14] + 0.2 * NEARER[:14], 30, axis=0), NONE[:1], 1.0, False, id="neighbours"),
        pytest.param(NONE, NONE, 1.0, False, id="nothing"),
        pytest.param(1e-12 * NEARER, NONE, 1.0, False, id="rounding"),
        pytest.param(-NEARER[:, ::-1], -0.5 * NEARER[:, ::-1], 1.0, False, id="the inverse is worse only"),
        pytest.param(1.2 * NEARER, NEARER, 1.0, True, id="more"),
        pytest.param(1.2 * NEARER, NEARER, 1.25, False, id="not by the factor"),
        pytest.param(NEARER[:39], NONE[:39], 1.0, False, id="few pairs"),
        pytest.param(NEARER[:40], NONE[:40], 1.0, True, id="enough pairs"),
    ],
)
def test_is_better_asks_for_evidence_beyond_chance_and_nearer_scans(distances, now, factor, expected):
    assert is_better(distances, now, factor) is expected


def test_the_fastest_turns_are_those_of_a_body_that_turns_on_the_spot():
    drive = SurveyedDrive(0, NOISE, scans=2400, objects=80)
    spacing_m = spacing_of(drive.scans)

    def turn_rate(*, fastest: bool) -> float:
        pairs = ScanPairs.of(drive.scans, spacing_m, fastest=fastest)
        return float(np.mean(np.abs(yaw_rad(pairs.motions)) / np.diff(pairs.rows)[:, 0]))

    assert turn_rate(fastest=True) > 1.1 * turn_rate(fastest=False)


def test_a_body_that_trembles_does_not_travel(drive):
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (2000, 1, 1))
    T[:, :2, 3] = rng.normal(scale=0.05, size=(2000, 2))
    standing = [replace(drive.scans[0], T_odom_body=each) for each in T]
    assert len(ScanPairs.of(standing, spacing_of(standing)).rows) == 0


def test_evenly_chosen_pairs_are_all_over_the_way():
    assert _evenly(np.arange(11), 3).tolist() == [0, 5, 10]


def test_no_scan_is_paired_with_itself():
    """All objects in one place ask for no way at all between two scans."""
    assert not len(_reached(np.zeros(5), 0.0))
    assert not len(_reached(np.arange(4.0), 0.0))
    assert _reached(np.arange(30.0), 2.0).tolist() == [[first, first + 2] for first in range(28)]
    assert not len(_reached(np.arange(28.0), 2.0)), "fewer motions than blocks"


def test_the_spacing_is_the_distance_of_the_nearest_of_its_class(drive):
    scan = drive.scans[0]
    apart = np.linalg.norm(scan.positions[:, None] - scan.positions, axis=2)
    apart[(scan.labels[:, None] != scan.labels) | np.eye(len(apart), dtype=bool)] = np.inf
    assert spacing_of([scan]) == pytest.approx(np.median(apart.min(axis=1)))
    alone = replace(scan, labels=np.arange(len(scan.labels)))
    assert spacing_of([alone]) == pytest.approx(np.median(np.linalg.norm(scan.positions, axis=1)))
