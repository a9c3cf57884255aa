"""Pairs of scans: which there are, and how near the motion of the body brings their detections to one another."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from slam.common.geometry import apply, invert, make_transform, yaw_rad
from slam.self_calibration.scan_pairs import (
    RESOLVED_SPACINGS,
    ScanPairs,
    _reached,
    evidence,
    is_better,
    seen_by,
    spacing_of,
)
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


def test_turning_the_detections_is_turning_the_scans(drive):
    R = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    pairs = ScanPairs.of(drive.scans, spacing_of(drive.scans))
    other = [replace(scan, positions=scan.positions @ R.T) for scan in drive.scans]
    expected = ScanPairs(other, pairs.rows, pairs.spacing_m).log_distances(pairs.motions)
    np.testing.assert_allclose(
        pairs.log_distances(seen_by(make_transform(R, np.zeros(3)), pairs.motions)), expected, atol=1e-9
    )


def test_motions_have_no_roll_and_pitch(drive):
    pairs = ScanPairs.of(drive.scans, spacing_of(drive.scans))
    tilted = np.stack([scan.T_odom_body @ motion_by([0.2, -0.1, 0.0]) for scan in drive.scans])
    np.testing.assert_allclose(pairs.motions_by(tilted)[:, 2], [[0.0, 0.0, 1.0, 0.0]] * len(pairs.rows), atol=1e-9)


def test_a_body_that_stands_still_gives_no_evidence(drive):
    pairs = ScanPairs.of(drive.scans, spacing_of(drive.scans))
    standing = pairs.motions_by(np.repeat(np.eye(4)[None], len(drive.scans), axis=0))
    np.testing.assert_allclose(evidence(pairs.log_distances(standing)), 0.0, atol=1e-9)


def test_the_body_travels_or_turns_between_the_scans_of_a_pair(drive):
    spacing_m = spacing_of(drive.scans)
    for motion in ScanPairs.of(drive.scans, spacing_m).motions:
        turned_m = drive.range_m * abs(np.arctan2(motion[1, 0], motion[0, 0]))
        assert np.linalg.norm(motion[:2, 3]) + turned_m > 0.1 * spacing_m


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
        pytest.param(-NEARER[:, ::-1], NONE, 1.0, False, id="the inverse is worse only"),
        pytest.param(1.2 * NEARER, NEARER, 1.0, True, id="more"),
        pytest.param(1.2 * NEARER, NEARER, 1.25, False, id="not by the factor"),
        pytest.param(NEARER[:39], NONE[:39], 1.0, False, id="few pairs"),
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


def test_no_scan_is_paired_with_itself():
    """All objects in one place ask for no way at all between two scans."""
    assert not len(_reached(np.zeros(5), 0.0))
    assert not len(_reached(np.arange(4.0), 0.0))
    assert _reached(np.arange(30.0), 2.0).tolist() == [[first, first + 2] for first in range(28)]


def test_way_of_fewer_motions_than_blocks_gives_no_pairs():
    assert not len(_reached(np.arange(28.0), 2.0))


def test_the_spacing_is_the_distance_of_the_nearest_of_its_class(drive):
    scan = drive.scans[0]
    apart = np.linalg.norm(scan.positions[:, None] - scan.positions, axis=2)
    apart[(scan.labels[:, None] != scan.labels) | np.eye(len(apart), dtype=bool)] = np.inf
    assert spacing_of([scan]) == pytest.approx(np.median(apart.min(axis=1)))
    alone = replace(scan, labels=np.arange(len(scan.labels)))
    assert spacing_of([alone]) == pytest.approx(np.median(np.linalg.norm(scan.positions, axis=1)))


def test_the_spacing_of_many_objects_takes_no_memory_of_all_their_pairs():
    positions = np.random.default_rng(0).uniform(-50.0, 50.0, (5000, 3))
    scan = replace(SurveyedDrive(0, NOISE, scans=2, objects=80).scans[0], positions=positions,
                   labels=np.zeros(5000, int))  # fmt: skip
    tracemalloc.start()
    try:
        spacing_of([scan])
        assert tracemalloc.get_traced_memory()[1] < 60e6
    finally:
        tracemalloc.stop()
