from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Odometry, Transform
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import transform_from_xyz_yaw
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.recording import Message, Recording, make_recording
from slam.simulation.faults.registry import parse_faults
from tests.slam.simulation.faults.streams import (
    COUNT,
    COVARIANCE,
    IDS,
    LABELS,
    PERIOD_NS,
    STAMPS_NS,
    T_BODY_SENSOR,
    drive,
    faulty,
    labels,
    messages,
    positions,
    records,
    stamps,
)

TOTAL = 4 * COUNT


def object_ids(log: Recording) -> list[tuple[str, ...]]:
    return [record.object_ids for record in records(log, DetectionTruth)]


def from_sensor() -> FloatArray:
    """Positions (COUNT, 4, 3) of the drive from the sensor, in the axes of the body."""
    return np.asarray(positions(drive()) @ T_BODY_SENSOR[:3, :3].T)


def expected_ids(kept: FloatArray) -> list[tuple[str, ...]]:
    """Of a mask (COUNT, 4)."""
    return [tuple(name for name, is_kept in zip(IDS, row, strict=True) if is_kept) for row in kept]


def test_dropout_loses_detections_with_their_true_ids() -> None:
    changed = faulty("dropout=0.3")
    counts = [len(record.labels) for record in records(changed, ObjectDetections)]
    assert sum(counts) / TOTAL == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / TOTAL))
    meaning = dict(zip(IDS, LABELS, strict=True))
    assert labels(changed) == [tuple(meaning[i] for i in ids) for ids in object_ids(changed)]
    assert {len(record.labels) for record in records(faulty("dropout=1"), ObjectDetections)} == {0}


def test_position_noise_is_added_to_known_covariances() -> None:
    changed = apply_faults(drive().with_detections(_without_covariance), parse_faults(["position_noise=0.3"]), seed=0)
    noise = positions(changed) - positions(drive())
    assert noise.std(axis=(0, 1)) == pytest.approx(np.full(3, 0.3), rel=4 / np.sqrt(2 * TOTAL))
    covariances = records(changed, ObjectDetections)[0].covariances
    assert covariances[1:] == pytest.approx(np.tile(COVARIANCE + 0.09 * np.eye(3), (3, 1, 1)))
    assert not covariances[0].any()


def _without_covariance(scan: ObjectDetections) -> ObjectDetections:
    scan.covariances[0] = 0.0
    return scan


@pytest.mark.parametrize("angle_deg", [60.0, 180.0])
def test_field_of_view_is_about_straight_ahead_of_the_body(angle_deg: float) -> None:
    x, y, _ = np.moveaxis(from_sensor(), -1, 0)
    ahead = np.abs(np.rad2deg(np.arctan2(y, x))) <= 0.5 * angle_deg
    assert 0 < ahead.sum() < TOTAL
    assert object_ids(faulty(f"field_of_view={angle_deg}")) == expected_ids(ahead)


def test_range_is_horizontal_and_from_the_sensor() -> None:
    near = np.hypot(*np.moveaxis(from_sensor()[..., :2], -1, 0)) <= 12.0
    assert object_ids(faulty("max_range=12")) == expected_ids(near)


@pytest.mark.parametrize(
    ("fault", "kept"), [("keep_label=tree:lamp", {"tree", "lamp"}), ("drop_label=tree", {"lamp", "bench"})]
)
def test_labels_are_kept_or_dropped(fault: str, kept: set[str]) -> None:
    assert {label for scan in labels(faulty(fault)) for label in scan} == kept


def test_confused_labels_become_every_other_one() -> None:
    pairs = [pair for scan in labels(faulty("label_confusion=0.4")) for pair in zip(LABELS, scan, strict=True)]
    became = Counter(new for old, new in pairs if old == "tree" and new != old)
    assert became.total() / (TOTAL / 2) == pytest.approx(0.4, abs=4 * np.sqrt(0.24 / (TOTAL / 2)))
    assert became["lamp"] / became.total() == pytest.approx(0.5, abs=2.0 / np.sqrt(became.total()))


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


def test_reversed_drive_mirrors_stamps_of_all_that_moves() -> None:
    T_moving = transform_from_xyz_yaw(np.array([1.0, 0.0, 0.0]), 0.0)
    moving = [Message("/tf", int(s), Transform(int(s), "mount", "camera", T)) for s, T in
              zip(STAMPS_NS[:2], (T_moving, np.eye(4)), strict=True)]  # fmt: skip
    changed = apply_faults(make_recording([*moving, *messages()]), parse_faults(["reversed"]), seed=0)
    for kind in (Odometry, ObjectDetections, DetectionTruth, GroundTruthPose):
        assert np.array_equal(stamps(changed, kind), STAMPS_NS)
        key = {Odometry: "T_odom_body", GroundTruthPose: "T_world_body"}.get(kind, "stamp_ns")
        if key != "stamp_ns":
            before = [getattr(record, key) for record in records(drive(), kind)]
            assert np.array_equal([getattr(record, key) for record in records(changed, kind)], before[::-1])
    assert positions(changed)[0] == pytest.approx(positions(drive())[-1])
    still = [t.stamp_ns for t in records(changed, Transform) if t.child_frame_id == "lidar"]
    assert still == [STAMPS_NS[0]]
    turned = [t.stamp_ns for t in records(changed, Transform) if t.child_frame_id == "camera"]
    assert turned == [STAMPS_NS[-1] - PERIOD_NS, STAMPS_NS[-1]]


def test_reversed_twice_is_the_drive_itself() -> None:
    twice = faulty("reversed", "reversed")
    assert np.array_equal(positions(twice), positions(drive()))
    assert np.array_equal(stamps(twice, ObjectDetections), STAMPS_NS)


def test_noise_of_a_detection_does_not_depend_on_what_is_lost_later() -> None:
    noisy, lossy = faulty("position_noise=0.2"), faulty("position_noise=0.2", "dropout=0.5")
    for scan, left, ids in zip(positions(noisy), records(lossy, ObjectDetections), object_ids(lossy), strict=True):
        assert np.array_equal(left.positions, scan[[IDS.index(name) for name in ids]])


def test_true_ids_of_other_detections_are_left_out() -> None:
    log = make_recording(
        message.with_fields(object_ids=IDS[1:]) if isinstance(message.record, DetectionTruth) else message
        for message in messages()
    )
    assert records(apply_faults(log, parse_faults(["dropout=0.5"]), seed=0), DetectionTruth) == []


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("keep_label=car", "'car'.*bench, lamp, tree"),
        ("drop_label=bench:lamp:tree", "no label is left"),
    ],
)
def test_labels_that_cannot_be_are_refused(fault: str, reason: str) -> None:
    with pytest.raises(SimulationError, match=reason):
        faulty(fault)


def test_the_only_label_cannot_be_confused() -> None:
    with pytest.raises(SimulationError, match="only label"):
        faulty("keep_label=lamp", "label_confusion=0.1")


def test_false_positives_need_a_detection() -> None:
    with pytest.raises(SimulationError, match="widen the field"):
        faulty("dropout=1", "false_positives=1")


@pytest.mark.parametrize("fault", ["max_range=9", "field_of_view=90", "false_positives=1"])
def test_bearings_in_the_frame_of_the_odometry_are_refused(fault: str) -> None:
    scan = ObjectDetections(int(STAMPS_NS[0]), "odom", np.ones((1, 3)), ("tree",), np.ones(1))
    log = drive().with_detections(lambda _: scan)
    with pytest.raises(SimulationError, match="frame of the odometry"):
        apply_faults(log, parse_faults([fault]), seed=0)
