"""Faults of stamps, positions, labels and objects, each by what it makes of the drive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, ObjectMapRecord, Odometry, Transform
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.registry import parse_faults
from tests.slam.simulation.faults.streams import (
    COUNT,
    COVARIANCE,
    HALF_NS,
    IDS,
    LABELS,
    OBJECTS,
    STAMPS_NS,
    T_BODY_SENSOR,
    drive,
    faulty,
    labels,
    path,
    positions,
    records,
    stamps,
)

HALF = 50
AFTER = STAMPS_NS >= HALF_NS
IN_GAP = AFTER & (STAMPS_NS < HALF_NS + 2 * 10**9)

# Stamps.

SCANS, ODOMETRY, BOTH = (ObjectDetections, DetectionTruth), (Odometry,), (ObjectDetections, DetectionTruth, Odometry)
STAMPS: dict[str, tuple[tuple[type, ...], IntArray]] = {
    "time_offset=0.25": (SCANS, STAMPS_NS + 250_000_000),
    "time_offset=-2": (SCANS, STAMPS_NS - 2 * 10**9),
    "time_offset=-55": (SCANS, STAMPS_NS[STAMPS_NS >= 55 * 10**9] - 55 * 10**9),  # none is before zero
    "detections_clock_back=30": (SCANS, STAMPS_NS - 30 * 10**9 * AFTER),
    "odometry_clock_back=3": (ODOMETRY, STAMPS_NS - 3 * 10**9 * AFTER),
    "detections_clock_slow=1000": (SCANS, STAMPS_NS - (STAMPS_NS - STAMPS_NS[0]) // 1000),
    "stamps_coarse=0.5": (SCANS, STAMPS_NS // 500_000_000 * 500_000_000),
    "stamps_in_microseconds": (SCANS, STAMPS_NS // 1000),
    "scan_rate=2": (SCANS, STAMPS_NS[::5]),
    "frame_rate=1": (BOTH, STAMPS_NS[::10]),
    "frame_rate=10": (BOTH, STAMPS_NS),
    "log_gap=2": (BOTH, STAMPS_NS[~IN_GAP]),
    "messages_twice": (BOTH, np.repeat(STAMPS_NS, 2)),
    "detections_stop=0.25": (SCANS, STAMPS_NS[:25]),
}
"""Kinds whose stamps a fault changes, and what they become."""


@pytest.mark.parametrize("fault", STAMPS)
def test_fault_changes_these_stamps(fault: str) -> None:
    kinds, expected = STAMPS[fault]
    changed = faulty(fault)
    for kind in BOTH:
        assert np.array_equal(stamps(changed, kind), expected if kind in kinds else STAMPS_NS), kind
    if len(changed.messages) == len(drive().messages):
        assert [e.log_time_ns for e in changed.messages] == [e.log_time_ns for e in drive().messages]


# Positions.

POSITIONS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "one_point=5": lambda before: np.tile([5.0, 0.0, 0.0], (COUNT, 4, 1)),
    "height_offset=2": lambda before: before + np.array([0.0, 0.0, 2.0]) @ T_BODY_SENSOR[:3, :3],
    "sensor_upside_down": lambda before: before * [1.0, -1.0, -1.0],
    # Turned to the left, the sensor sees what is ahead of the body to its right.
    "sensor_yaw=90": lambda before: np.stack([before[..., 1], -before[..., 0], before[..., 2]], axis=-1),
    "sensor_optical": lambda before: np.stack([-before[..., 1], -before[..., 2], before[..., 0]], axis=-1),
    "ranges_scaled=1.1": lambda before: 1.1 * before,
    "sensor_mirrored=2": lambda before: np.where(IN_GAP[:, None, None], before * [1.0, -1.0, 1.0], before),
    "scan_repeated=2": lambda before: np.where(IN_GAP[:, None, None], before[49], before),
    "claimed_sigma=0.001": lambda before: before,
    "objects_few=2": lambda before: before[:, :2],
    "odometry_frame": lambda before: np.array(
        [apply(T @ T_BODY_SENSOR, at) for T, at in zip(drive().poses, before, strict=True)]
    ),
}
COVARIANCES = {
    "sensor_yaw=90": np.diag([0.04, 0.01, 0.09]),
    "claimed_sigma=0.001": 1e-6 * np.eye(3),
    "odometry_frame": (drive().poses[0] @ T_BODY_SENSOR)[:3, :3]
    @ COVARIANCE
    @ (drive().poses[0] @ T_BODY_SENSOR)[:3, :3].T,
    "ranges_scaled=1.1": COVARIANCE,
}
"""Of the first detection after a fault."""


@pytest.mark.parametrize("fault", POSITIONS)
def test_fault_changes_these_positions(fault: str) -> None:
    np.testing.assert_allclose(positions(faulty(fault)), POSITIONS[fault](positions(drive())), atol=1e-9)
    if fault in COVARIANCES:
        first = records(faulty(fault), ObjectDetections)[0].covariances[0]
        np.testing.assert_allclose(first, COVARIANCES[fault], atol=1e-12)


def test_unreported_noise_leaves_covariances() -> None:
    changed = faulty("unreported_noise=2")
    noise = positions(changed) - positions(drive())
    assert noise.std() == pytest.approx(2.0, rel=0.1)
    assert noise.mean(axis=(0, 1)) == pytest.approx(np.zeros(3), abs=0.5)
    covariances = [scan.covariances for scan in records(changed, ObjectDetections)]
    assert np.array_equal(covariances, np.tile(COVARIANCE, (COUNT, 4, 1, 1)))


@pytest.mark.parametrize("factor", [0.0, 3.0])
def test_errors_against_the_truth_are_multiplied(factor: float) -> None:
    true = np.array([apply(invert(T @ T_BODY_SENSOR), OBJECTS) for T in path()])
    errors = positions(faulty(f"detection_noise={factor}")) - true
    assert errors == pytest.approx(factor * (positions(drive()) - true), abs=1e-9)


def test_lengths_are_scaled_and_angles_are_not() -> None:
    changed = faulty("lengths_scaled=20")
    assert changed.poses[:, :3, 3] == pytest.approx(20.0 * drive().poses[:, :3, 3])
    assert np.array_equal(changed.poses[:, :3, :3], drive().poses[:, :3, :3])
    assert positions(changed) == pytest.approx(20.0 * positions(drive()))
    scan = records(changed, ObjectDetections)[0]
    assert scan.covariances[0] == pytest.approx(400.0 * COVARIANCE)
    assert np.array_equal(scan.sizes, np.full((4, 3), 20.0))
    assert records(changed, Transform)[0].T_parent_child[:3, 3] == pytest.approx(20.0 * T_BODY_SENSOR[:3, 3])
    truth = np.array([pose.T_world_body for pose in records(changed, GroundTruthPose)])
    assert truth[:, :3, 3] == pytest.approx(20.0 * path()[:, :3, 3])
    assert records(changed, ObjectMapRecord)[0].positions == pytest.approx(20.0 * OBJECTS)


# Labels.


def test_labels_are_of_the_log_of_their_own_or_of_one_class() -> None:
    drawn = Counter(label for scan in labels(faulty("labels_random")) for label in scan)
    assert set(drawn) == set(LABELS)
    assert min(drawn.values()) > 4 * COUNT / 3 * 0.7
    own = [label for scan in labels(faulty("labels_unique")) for label in scan]
    assert len(set(own)) == len(own) == 4 * COUNT
    assert len({label for scan in labels(faulty("labels_one_class")) for label in scan}) == 1


def test_labels_change_at_half_time() -> None:
    capitals, permuted = labels(faulty("labels_case")), labels(faulty("labels_permuted"))
    assert capitals[:HALF] == permuted[:HALF] == labels(drive())[:HALF]
    assert set(capitals[HALF:]) == {tuple(label.upper() for label in LABELS)}
    (after,) = set(permuted[HALF:])
    assert set(after) == set(LABELS)
    assert after[0] == after[1]  # both trees
    assert all(a != b for a, b in zip(after, LABELS, strict=True))


# Objects.


def test_many_more_objects_stand_around_for_a_while() -> None:
    changed = faulty("objects_burst=100:2")
    scans, truths = records(changed, ObjectDetections), records(changed, DetectionTruth)
    assert [len(scan.labels) == 104 for scan in scans] == IN_GAP.tolist()
    assert all(len(scan.labels) == len(scan.positions) == len(scan.scores) for scan in scans)
    assert truths[HALF].object_ids == IDS + ("",) * 100
    standing = [apply(drive().poses[i] @ T_BODY_SENSOR, scans[i].positions[4:]) for i in (HALF, HALF + 19)]
    assert standing[0] == pytest.approx(standing[1])
    assert np.array_equal(scans[HALF].positions[:4], positions(drive())[HALF])


def test_share_of_the_objects_moves_straight_on_over_the_ground() -> None:
    moved = []
    T_odom_sensor = drive().poses @ T_BODY_SENSOR
    for seed in range(20):
        shift = positions(faulty("objects_moving=0.5:2", seed=seed)) - positions(drive())
        over_ground = np.einsum("sij,skj->ski", T_odom_sensor[:, :3, :3], shift)
        assert not over_ground[0].any()
        assert over_ground[HALF] == pytest.approx(0.5 * over_ground[-1])
        moved += np.linalg.norm(over_ground[-1], axis=1).tolist()
    assert {round(distance, 6) for distance in moved} == {0.0, 20.0}
    assert 20 < np.count_nonzero(moved) < 60


@pytest.mark.parametrize(
    ("fault", "missing"),
    [
        ("objects_few", "/ground_truth/detections"),
        ("objects_moving", "/ground_truth/detections"),
        ("detection_noise", "/ground_truth"),
        ("detection_noise", "/ground_truth/detections"),
        ("detection_noise", "/ground_truth/objects"),
    ],
)
def test_fault_that_needs_a_truth_is_refused_without(fault: str, missing: str) -> None:
    without = drive(without=missing)
    with pytest.raises(SimulationError, match=missing):
        apply_faults(without, parse_faults([fault]), seed=0)
