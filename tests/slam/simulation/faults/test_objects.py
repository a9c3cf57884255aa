from __future__ import annotations

import numpy as np
import pytest

from logs.messages import DetectionTruth, ObjectDetections
from slam.common.errors import SimulationError
from slam.common.geometry import apply
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.registry import parse_faults
from tests.slam.simulation.faults.streams import (
    COUNT,
    IDS,
    STAMPS_NS,
    T_BODY_SENSOR,
    drive,
    faulty,
    poses,
    positions,
    records,
    stamps,
)

HALF = 50


def test_detections_stop() -> None:
    changed = faulty("detections_stop=0.25")
    assert np.array_equal(stamps(changed, ObjectDetections), STAMPS_NS[:25])
    assert np.array_equal(stamps(changed, DetectionTruth), STAMPS_NS[:25])


def test_many_more_objects_stand_around_for_a_while() -> None:
    changed = faulty("objects_burst=100:2")
    scans, truths = records(changed, ObjectDetections), records(changed, DetectionTruth)
    assert [i for i, scan in enumerate(scans) if len(scan.labels) == 104] == list(range(HALF, HALF + 20))
    assert all(len(scan.labels) == len(scan.positions) == len(scan.scores) for scan in scans)
    assert truths[HALF].object_ids == IDS + ("",) * 100
    standing = [apply(poses(drive())[i] @ T_BODY_SENSOR, scans[i].positions[4:]) for i in (HALF, HALF + 19)]
    assert standing[0] == pytest.approx(standing[1])
    assert np.array_equal(scans[HALF].positions[:4], positions(drive())[HALF])


def test_only_some_objects_are_left() -> None:
    changed = faulty("objects_few=2")
    assert len(records(changed, ObjectDetections)) == COUNT
    assert {truth.object_ids for truth in records(changed, DetectionTruth)} == {("a", "b")}
    assert np.array_equal(positions(changed), positions(drive())[:, :2])


def test_a_share_of_the_objects_moves_straight_on() -> None:
    moved = []
    for seed in range(20):
        shift_m = np.linalg.norm(positions(faulty("objects_moving=0.5:2", seed=seed)) - positions(drive()), axis=-1)
        moved += shift_m[-1].tolist()
        assert not shift_m[0].any()
        assert shift_m[HALF] == pytest.approx(0.5 * shift_m[-1])
    assert {round(distance, 6) for distance in moved} == {0.0, 20.0}
    assert 20 < np.count_nonzero(moved) < 60


def test_it_moves_in_one_direction_over_the_ground() -> None:
    shift = positions(faulty("objects_moving=1:2")) - positions(drive())
    T_odom_sensor = poses(drive()) @ T_BODY_SENSOR
    over_ground = np.einsum("sij,skj->ski", T_odom_sensor[:, :3, :3], shift)
    assert over_ground[HALF] == pytest.approx(0.5 * over_ground[-1])


@pytest.mark.parametrize("name", ["objects_few", "objects_moving"])
def test_objects_are_told_by_their_true_ids(name: str) -> None:
    without = [entry for entry in drive() if entry.topic != "/ground_truth/detections"]
    with pytest.raises(SimulationError, match="/ground_truth/detections"):
        apply_faults(without, parse_faults([name]), seed=0)


def test_the_last_scan_is_repeated_for_a_while() -> None:
    before, after = positions(drive()), positions(faulty("scan_repeated=2"))
    assert np.array_equal(after[50:70], np.tile(before[49], (20, 1, 1)))
    assert np.array_equal(after[:50], before[:50])
    assert np.array_equal(after[70:], before[70:])
    assert np.array_equal(stamps(faulty("scan_repeated=2"), ObjectDetections), STAMPS_NS)
