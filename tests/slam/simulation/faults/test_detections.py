"""Faults of stamps, positions, labels and objects, each by what it makes of the drive."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, ObjectMapRecord, Odometry, Transform
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply
from slam.simulation.faults.recording import Recording, make_recording
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
    messages,
    path,
    positions,
    records,
    stamps,
)

HALF, TOTAL = 50, 4 * COUNT
AFTER = STAMPS_NS >= HALF_NS
IN_GAP = AFTER & (STAMPS_NS < HALF_NS + 2 * 10**9)

SCANS, ODOMETRY, BOTH = (ObjectDetections, DetectionTruth), (Odometry,), (ObjectDetections, DetectionTruth, Odometry)
STAMPS: dict[str, tuple[tuple[type, ...], IntArray]] = {
    "time_offset=0.25": (SCANS, STAMPS_NS + 250_000_000),
    "time_offset=-55": (SCANS, STAMPS_NS[STAMPS_NS >= 55 * 10**9] - 55 * 10**9),  # none is before zero
    "detections_clock_back=30": (SCANS, STAMPS_NS - 30 * 10**9 * AFTER),
    "detections_clock_slow=1000": (SCANS, STAMPS_NS - (STAMPS_NS - STAMPS_NS[0]) // 1000),
    "stamps_in_microseconds": (SCANS, STAMPS_NS // 1000),
    "scan_rate=2": (SCANS, STAMPS_NS[::5]),
    "log_gap=2": (BOTH, STAMPS_NS[~IN_GAP]),
    "odometry_pause=2": (ODOMETRY, STAMPS_NS[~IN_GAP]),
    "odometry_backwards=2": (ODOMETRY, np.where(IN_GAP, 2 * HALF_NS + 2 * 10**9 - STAMPS_NS, STAMPS_NS)),
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


POSITIONS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "height_offset=2": lambda before: before + np.array([0.0, 0.0, 2.0]) @ T_BODY_SENSOR[:3, :3],
    "sensor_rotated": lambda before: before * [1.0, -1.0, -1.0],  # upside down
    # Turned to the left, the sensor sees what is ahead of the body to its right.
    "sensor_rotated=0:0:90": lambda before: np.stack([before[..., 1], -before[..., 0], before[..., 2]], axis=-1),
    "sensor_rotated=0:90": lambda before: np.stack([-before[..., 2], before[..., 1], before[..., 0]], axis=-1),
    "ranges_scaled=1.1": lambda before: 1.1 * before,
    "claimed_sigma=0.001": lambda before: before,
    "odometry_frame": lambda before: np.array(
        [apply(T @ T_BODY_SENSOR, at) for T, at in zip(drive().poses, before, strict=True)]
    ),
}
COVARIANCES = {
    "sensor_rotated=0:0:90": np.diag([0.04, 0.01, 0.09]),
    "claimed_sigma=0.001": 1e-6 * np.eye(3),
    "ranges_scaled=1.1": COVARIANCE,
}
"""Of the first detection after a fault."""


@pytest.mark.parametrize("fault", POSITIONS)
def test_fault_changes_these_positions(fault: str) -> None:
    np.testing.assert_allclose(positions(faulty(fault)), POSITIONS[fault](positions(drive())), atol=1e-9)
    if fault in COVARIANCES:
        first = records(faulty(fault), ObjectDetections)[0].covariances[0]
        np.testing.assert_allclose(first, COVARIANCES[fault], atol=1e-12)


@pytest.mark.parametrize(("fault", "added"), [("unreported_noise=0.3", 0.0), ("position_noise=0.3", 0.09)])
def test_known_covariances_contain_reported_noise(fault: str, added: float) -> None:
    log = drive()
    log.scans[0].seen.covariances[0] = 0.0
    changed = faulty(fault, log=log)
    noise = positions(changed) - positions(drive())
    assert noise.std(axis=(0, 1)) == pytest.approx(np.full(3, 0.3), rel=4 / np.sqrt(2 * TOTAL))
    covariances = records(changed, ObjectDetections)[0].covariances
    assert covariances[1:] == pytest.approx(np.tile(COVARIANCE + added * np.eye(3), (3, 1, 1)))
    assert not covariances[0].any()


def test_second_detections_are_of_the_same_objects_and_nearly_in_their_place() -> None:
    changed = faulty("detected_twice=0.01")
    before = records(drive(), ObjectDetections)
    pairs = zip(records(changed, ObjectDetections), before, strict=True)
    errors = np.stack([scan.positions - np.tile(old.positions, (2, 1)) for scan, old in pairs])
    first, second = np.split(errors, 2, axis=1)
    assert not first.any()
    ranges = np.stack([np.linalg.norm(scan.positions, axis=1) for scan in before])[..., None]
    assert np.std(second / ranges) == pytest.approx(0.01, rel=4 / np.sqrt(2 * second.size))
    assert labels(changed) == [scan.labels * 2 for scan in before]
    assert [scan.ids for scan in changed.scans] == [scan.ids * 2 for scan in drive().scans]


def test_lengths_are_scaled_and_angles_are_not() -> None:
    changed = faulty("lengths_scaled=20")
    assert changed.poses[:, :3, 3] == pytest.approx(20.0 * drive().poses[:, :3, 3])
    assert np.array_equal(changed.poses[:, :3, :3], drive().poses[:, :3, :3])
    assert positions(changed) == pytest.approx(20.0 * positions(drive()))
    scan = records(changed, ObjectDetections)[0]
    assert scan.covariances[0] == pytest.approx(400.0 * COVARIANCE)
    assert records(changed, Transform)[0].T_parent_child[:3, 3] == pytest.approx(20.0 * T_BODY_SENSOR[:3, 3])
    truth = np.array([pose.T_world_body for pose in records(changed, GroundTruthPose)])
    assert truth[:, :3, 3] == pytest.approx(20.0 * path()[:, :3, 3])
    assert records(changed, ObjectMapRecord)[0].positions == pytest.approx(20.0 * OBJECTS)


def test_labels_are_of_the_log_of_their_own_or_of_one_class() -> None:
    drawn = Counter(label for scan in labels(faulty("labels_random")) for label in scan)
    assert set(drawn) == set(LABELS)
    assert min(drawn.values()) > TOTAL / 3 * 0.8  # LABELS themselves have 0.75
    own = [label for scan in labels(faulty("labels_unique")) for label in scan]
    assert len(set(own)) == len(own) == TOTAL
    assert len({label for scan in labels(faulty("labels_one_class")) for label in scan}) == 1


def test_confused_labels_become_every_other_one() -> None:
    pairs = [pair for scan in labels(faulty("label_confusion=0.4")) for pair in zip(LABELS, scan, strict=True)]
    became = Counter(new for old, new in pairs if old == "tree" and new != old)
    assert became.total() / (TOTAL / 2) == pytest.approx(0.4, abs=4 * np.sqrt(0.24 / (TOTAL / 2)))
    assert became["lamp"] / became.total() == pytest.approx(0.5, abs=2.0 / np.sqrt(became.total()))


def object_ids(log: Recording) -> list[tuple[str, ...]]:
    return [record.object_ids for record in records(log, DetectionTruth)]


def test_dropout_loses_detections_with_their_true_ids() -> None:
    noisy, lossy = faulty("position_noise=0.2"), faulty("position_noise=0.2", "dropout=0.3")
    counts = [len(record.labels) for record in records(lossy, ObjectDetections)]
    assert sum(counts) / TOTAL == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / TOTAL))
    for scan, left, ids in zip(positions(noisy), records(lossy, ObjectDetections), object_ids(lossy), strict=True):
        assert np.array_equal(left.positions, scan[[IDS.index(name) for name in ids]])
        assert left.labels == tuple(LABELS[IDS.index(name)] for name in ids)


def test_sensor_sees_what_is_ahead_of_the_body_and_near_the_sensor() -> None:
    x, y, _ = np.moveaxis(positions(drive()) @ T_BODY_SENSOR[:3, :3].T, -1, 0)
    for fault, kept in (
        ("field_of_view=60", np.abs(np.rad2deg(np.arctan2(y, x))) <= 30.0),
        ("max_range=12", np.hypot(x, y) <= 12.0),
        ("keep_label=tree:lamp", np.tile([True, True, True, False], (COUNT, 1))),
    ):
        expected = [tuple(name for name, is_kept in zip(IDS, row, strict=True) if is_kept) for row in kept]
        assert 0 < kept.sum() < TOTAL
        assert object_ids(faulty(fault)) == expected


def test_false_positives_lie_where_detections_do() -> None:
    changed = faulty("field_of_view=90", "false_positives=4")
    counts = np.array([ids.count("") for ids in object_ids(changed)])
    assert counts.mean() == pytest.approx(4.0, abs=4 * np.sqrt(4.0 / COUNT))
    seen, false = [], []
    for scan, ids in zip(records(changed, ObjectDetections), object_ids(changed), strict=True):
        for name, position in zip(ids, scan.positions @ T_BODY_SENSOR[:3, :3].T, strict=True):
            (seen if name else false).append(position)
    ranges_m = [np.hypot(*np.array(each)[:, :2].T) for each in (seen, false)]
    reach_m = np.percentile(ranges_m[0], 95.0)
    assert ranges_m[1].max() <= reach_m
    # Even over a sector: the squared range is uniform.
    assert (ranges_m[1] ** 2).mean() == pytest.approx(0.5 * reach_m**2, abs=4 * reach_m**2 / np.sqrt(12 * len(false)))
    assert (np.array(false)[:, 0] > 0.0).all()
    assert set(np.round(np.array(false)[:, 2], 9)) <= set(np.round(np.array(seen)[:, 2], 9))


def test_share_of_the_objects_moves_straight_on_over_the_ground() -> None:
    moved = []
    T_odom_sensor = drive().poses @ T_BODY_SENSOR
    for seed in range(8):
        shift = positions(faulty("objects_moving=0.5:2", seed=seed)) - positions(drive())
        over_ground = np.einsum("sij,skj->ski", T_odom_sensor[:, :3, :3], shift)
        assert not over_ground[0].any()
        assert over_ground[HALF] == pytest.approx(0.5 * over_ground[-1])
        moved += np.linalg.norm(over_ground[-1], axis=1).tolist()
    assert {round(distance, 6) for distance in moved} == {0.0, 20.0}
    assert 8 < np.count_nonzero(moved) < 24


def test_true_ids_of_other_detections_are_left_out() -> None:
    log = make_recording(
        message.having(object_ids=IDS[1:]) if isinstance(message.record, DetectionTruth) else message
        for message in messages()
    )
    assert records(faulty("dropout=0.5", log=log), DetectionTruth) == []


@pytest.mark.parametrize(
    ("faults", "reason"),
    [
        ("keep_label=car", "'car'.*bench, lamp, tree"),
        ("keep_label=lamp,label_confusion=0.1", "only label"),
        ("dropout=1,false_positives=1", "widen the field"),
    ],
)
def test_faults_that_cannot_be_are_refused(faults: str, reason: str) -> None:
    with pytest.raises(SimulationError, match=reason):
        faulty(faults)


def test_missing_truth_and_the_frame_of_the_odometry_are_refused() -> None:
    with pytest.raises(SimulationError, match=r"objects_moving=0\.5:2: .*/ground_truth/detections"):
        faulty("objects_moving", log=drive(without="/ground_truth/detections"))
    for fault in ("max_range=9", "field_of_view=90", "false_positives=1"):
        log = drive()
        log.scans[0].change(frame_id="odom")
        with pytest.raises(SimulationError, match="frame of the odometry"):
            faulty(fault, log=log)
