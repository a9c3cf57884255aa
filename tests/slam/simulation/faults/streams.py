"""A made-up drive of ten seconds, and how tests read a recording."""

from typing import TypeVar

import numpy as np

from logs.messages import (
    DetectionTruth,
    GroundTruthPose,
    ObjectDetections,
    ObjectMapRecord,
    Odometry,
    Record,
    Transform,
)
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.recording import Message, Recording, make_recording
from slam.simulation.faults.registry import parse_faults
from tests.helpers.poses import pose_at

COUNT = 101
PERIOD_NS = 100_000_000
START_NS = 50_000_000_000
HALF_NS = START_NS + 50 * PERIOD_NS
STAMPS_NS = START_NS + PERIOD_NS * np.arange(COUNT)
IDS = ("a", "b", "c", "d")
LABELS = ("tree", "tree", "lamp", "bench")
OBJECTS = np.array([[10.0, 5.0, 1.0], [20.0, -4.0, 0.5], [30.0, 6.0, 0.0], [5.0, -8.0, 2.0]])
COVARIANCE = np.diag([0.01, 0.04, 0.09])
T_BODY_SENSOR = pose_at(1.0, 0.5, z=2.0, yaw=np.deg2rad(90.0))

_Kind = TypeVar("_Kind")


def path(turn_rad: float = 0.02, step_m: float = 0.5) -> FloatArray:
    """Poses (COUNT, 4, 4) on an arc."""
    step = pose_at(step_m, yaw=turn_rad)
    poses = [pose_at(3.0, 2.0, yaw=0.3)]
    for _ in range(COUNT - 1):
        poses.append(poses[-1] @ step)
    return np.array(poses)


def messages() -> list[Message[Record]]:
    """Odometry that is 2 % too long and turns too much; scans of four objects, each off by its own centimetres."""
    odometry, truth = path(0.021, 0.51), path()
    vocabulary = ("bench", "lamp", "tree")
    classes = [vocabulary.index(label) for label in LABELS]
    truth_map = ObjectMapRecord.of_objects(IDS, OBJECTS, classes, vocabulary, stamp_ns=START_NS, frame_id="world")
    found: list[Message[Record]] = [
        Message("/tf_static", START_NS, Transform(START_NS, "base_link", "lidar", T_BODY_SENSOR)),
        Message("/ground_truth/objects", START_NS, truth_map),
    ]
    for i, stamp_ns in enumerate(STAMPS_NS.tolist()):
        seen = apply(invert(truth[i] @ T_BODY_SENSOR), OBJECTS) + 0.01 * (np.arange(12).reshape(4, 3) - 5.0)
        covariances = np.tile(COVARIANCE, (4, 1, 1))
        scan = ObjectDetections(stamp_ns, "lidar", seen, LABELS, np.ones(4), covariances)
        found += [
            Message("/odom", stamp_ns, Odometry(stamp_ns, odometry[i])),
            Message("/detections", stamp_ns, scan),
            Message("/ground_truth/detections", stamp_ns, DetectionTruth(stamp_ns, IDS)),
            Message("/ground_truth", stamp_ns, GroundTruthPose(stamp_ns, truth[i])),
        ]
    return found


def drive(*, without: str = "") -> Recording:
    """The drive, without a topic."""
    return make_recording(message for message in messages() if message.topic != without)


def faulty(*texts: str, seed: int = 0, log: Recording | None = None) -> Recording:
    """The drive, or another log, with faults."""
    changed = drive() if log is None else log
    apply_faults(changed, parse_faults(texts), seed=seed)
    return changed


def records(log: Recording, kind: type[_Kind]) -> list[_Kind]:
    return [message.record for message in log.messages if isinstance(message.record, kind)]


def stamps(log: Recording, kind: type) -> IntArray:
    return np.array([record.stamp_ns for record in records(log, kind)], int)


def positions(log: Recording) -> FloatArray:
    """Of recordings with four objects in each scan: (S, 4, 3)."""
    return np.array([scan.seen.positions for scan in log.scans])


def labels(log: Recording) -> list[tuple[str, ...]]:
    return [scan.seen.labels for scan in log.scans]
