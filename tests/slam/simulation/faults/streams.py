"""A made-up drive of ten seconds as a stream, and how tests read one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, ObjectMapRecord, Odometry, Transform
from logs.reader import LogReader
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.registry import parse_faults
from slam.simulation.faults.stream import Entry

COUNT = 101
PERIOD_NS = 100_000_000
START_NS = 50_000_000_000
HALF_NS = START_NS + 50 * PERIOD_NS
STAMPS_NS = START_NS + PERIOD_NS * np.arange(COUNT)
IDS = ("a", "b", "c", "d")
LABELS = ("tree", "tree", "lamp", "bench")
OBJECTS = np.array([[10.0, 5.0, 1.0], [20.0, -4.0, 0.5], [30.0, 6.0, 0.0], [5.0, -8.0, 2.0]])
COVARIANCE = np.diag([0.01, 0.04, 0.09])
T_BODY_SENSOR = transform_from_xyz_yaw(np.array([1.0, 0.5, 2.0]), np.deg2rad(90.0))

_Kind = TypeVar("_Kind")


def path(turn_rad: float = 0.02, step_m: float = 0.5) -> FloatArray:
    """Poses (COUNT, 4, 4) on an arc."""
    step = transform_from_xyz_yaw(np.array([step_m, 0.0, 0.0]), turn_rad)
    poses = [transform_from_xyz_yaw(np.array([3.0, 2.0, 0.0]), 0.3)]
    for _ in range(COUNT - 1):
        poses.append(poses[-1] @ step)
    return np.array(poses)


def drive() -> list[Entry]:
    """Odometry that is 2 % too long and turns too much; scans of four objects, each off by its own centimetres."""
    odometry, truth = path(0.021, 0.51), path()
    entries = [
        Entry("/tf_static", START_NS, Transform(START_NS, "base_link", "lidar", T_BODY_SENSOR)),
        Entry("/ground_truth/objects", START_NS, _objects()),
    ]
    for i, stamp_ns in enumerate(STAMPS_NS.tolist()):
        seen = apply(invert(truth[i] @ T_BODY_SENSOR), OBJECTS) + 0.01 * (np.arange(12).reshape(4, 3) - 5.0)
        covariances = np.tile(COVARIANCE, (4, 1, 1))
        scan = ObjectDetections(stamp_ns, "lidar", seen, LABELS, np.ones(4), covariances, np.ones((4, 3)))
        entries += [
            Entry("/odom", stamp_ns, Odometry(stamp_ns, odometry[i], covariance=np.eye(6))),
            Entry("/detections", stamp_ns, scan),
            Entry("/ground_truth/detections", stamp_ns, DetectionTruth(stamp_ns, IDS)),
            Entry("/ground_truth", stamp_ns, GroundTruthPose(stamp_ns, truth[i])),
        ]
    return entries


def faulty(*names: str, seed: int = 0) -> list[Entry]:
    """The drive with faults."""
    return apply_faults(drive(), parse_faults(names), seed=seed)


def records(stream: Sequence[Entry], kind: type[_Kind]) -> list[_Kind]:
    return [entry.content for entry in stream if isinstance(entry.content, kind)]


def stamps(stream: Sequence[Entry], kind: type) -> IntArray:
    return np.array([record.stamp_ns for record in records(stream, kind)], dtype=np.int64)


def poses(stream: Sequence[Entry]) -> FloatArray:
    return np.array([record.T_odom_body for record in records(stream, Odometry)])


def steps(stream: Sequence[Entry]) -> FloatArray:
    """T_previous_next of the odometry."""
    T = poses(stream)
    return invert(T[:-1]) @ T[1:]


def positions(stream: Sequence[Entry]) -> FloatArray:
    """Of streams with four objects in each scan: (S, 4, 3)."""
    return np.array([record.positions for record in records(stream, ObjectDetections)])


def labels(stream: Sequence[Entry]) -> list[tuple[str, ...]]:
    return [record.labels for record in records(stream, ObjectDetections)]


def changed_topics(before: Sequence[Entry], after: Sequence[Entry]) -> set[str]:
    """Topics whose messages are not the very same objects as before."""
    found = set()
    for topic in {entry.topic for entry in [*before, *after]}:
        old, new = ([(e.log_time_ns, e.content) for e in s if e.topic == topic] for s in (before, after))
        same = len(old) == len(new) and all(a[0] == b[0] and a[1] is b[1] for a, b in zip(old, new, strict=True))
        found |= set() if same else {topic}
    return found


def raw_messages(path: Path, *topics: str) -> list[tuple[str, int, bytes]]:
    with LogReader(path) as reader:
        return [(raw.topic, raw.log_time_ns, raw.data) for raw in reader.messages(topics or None)]


def _objects() -> ObjectMapRecord:
    vocabulary = ("bench", "lamp", "tree")
    classes = [vocabulary.index(label) for label in LABELS]
    return ObjectMapRecord.of_objects(IDS, OBJECTS, classes, vocabulary, stamp_ns=START_NS, frame_id="world")
