"""A small made-up log, and what the tests of degradations ask of it and of what became of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from logs.messages import (
    DetectionTruth,
    GroundTruthPose,
    ObjectDetections,
    Odometry,
    Record,
    StatusRecord,
    Transform,
)
from logs.reader import LogReader
from logs.selection import select_topics
from logs.writer import LogWriter
from slam.common.arrays import FloatArray
from slam.common.geometry import transform_from_xyz_yaw
from slam.simulation.degradation import (
    make_degradation,
)
from slam.simulation.degraded_log import DegradationSummary, write_degraded

SCANS, EACH = 100, 50
COUNT = SCANS * EACH
START_NS, PERIOD_NS = 5_000_000_000, 100_000_000
LABELS = ("lamp", "sign", "tree")
# Turned to the left and far from the body's origin, so that translating instead of rotating shows.
T_BODY_SENSOR = transform_from_xyz_yaw(np.array([20.0, 5.0, 1.0]), np.deg2rad(90.0))
WIDTH_M = 30.0


@dataclass(frozen=True)
class Degraded:
    records: dict[str, list[Any]]
    summary: DegradationSummary
    path: Path


def scan(stamp_ns: int, rng: np.random.Generator, frame: str = "lidar") -> ObjectDetections:
    positions = rng.uniform(-WIDTH_M, WIDTH_M, (EACH, 3)) * [1.0, 1.0, 0.1]
    labels = tuple(rng.choice(LABELS, EACH, p=[0.5, 0.3, 0.2]).tolist())
    covariances = np.tile(0.04 * np.eye(3), (EACH, 1, 1))
    covariances[::2] = 0.0
    return ObjectDetections(
        stamp_ns,
        frame,
        positions,
        labels,
        rng.uniform(0.1, 1.0, EACH),
        covariances,
        np.tile(positions[:, :1] ** 2, (1, 3)),
        tuple(f"track-{stamp_ns}-{i}" for i in range(EACH)),
    )


def drive(*, rng: np.random.Generator, with_transform: bool = True) -> list[tuple[str, Record]]:
    records: list[tuple[str, Record]] = [("/status", StatusRecord(START_NS, "mapping", "info", "on its way"))]
    if with_transform:
        records.append(("/tf_static", Transform(START_NS, "base_link", "lidar", T_BODY_SENSOR)))
    for i in range(SCANS):
        stamp_ns = START_NS + i * PERIOD_NS
        T_world_body = transform_from_xyz_yaw(np.array([0.8 * i, 0.01 * i**2, 0.0]), 0.01 * i)
        detections = scan(stamp_ns, rng)
        truth = DetectionTruth(stamp_ns, tuple(f"object of {track}" for track in detections.track_ids or ()))
        # The truth stands before or after the detections.
        pair: list[tuple[str, Record]] = [("/detections", detections), ("/ground_truth/detections", truth)]
        pair = pair if i % 2 else pair[::-1]
        records += [("/odom", Odometry(stamp_ns, T_world_body)), *pair]
        records.append(("/ground_truth", GroundTruthPose(stamp_ns, T_world_body)))
    return records


def write(path: Path, records: list[tuple[str, Record]], metadata: Mapping[str, str] | None = None) -> Path:
    with LogWriter(path) as writer:
        writer.add_metadata("source", metadata or {"dataset": "made up"})
        for topic, record in records:
            writer.write(topic, record, record.stamp_ns + 7_000_000)
    return path


def read(path: Path) -> dict[str, list[Any]]:
    with LogReader(path) as reader:
        found: dict[str, list[Any]] = {info.topic: [] for info in reader.topics()}
        for topic, _, record in reader.records(select_topics(reader.topics(), needed=())):
            found[topic].append(record)
    return found


def degrade(source: Path, *, seed: int = 0, **options: Any) -> Degraded:
    output = source.with_name("degraded.mcap")
    summary = write_degraded(source, output, make_degradation(options), seed=seed)
    return Degraded(read(output), summary, output)


def raw_messages(path: Path, *topics: str) -> list[tuple[str, int, bytes]]:
    with LogReader(path) as reader:
        return [(raw.topic, raw.log_time_ns, raw.data) for raw in reader.messages(topics or None)]


def tracks(records: dict[str, list[Any]]) -> list[str]:
    return [track for detections in records["/detections"] for track in detections.track_ids or ()]


def by_track(records: dict[str, list[Any]]) -> dict[str, tuple[FloatArray, str, FloatArray]]:
    """Position, label and covariance of each detection that has a track."""
    return {
        d.track_ids[i]: (d.positions[i], d.labels[i], d.covariances[i])
        for d in records["/detections"]
        for i in range(len(d.labels))
        if d.track_ids[i]
    }


def assert_true_ids_fit(records: dict[str, list[Any]]) -> None:
    for detections, truth in zip(records["/detections"], records["/ground_truth/detections"], strict=True):
        assert detections.stamp_ns == truth.stamp_ns
        assert list(truth.object_ids) == [f"object of {track}" if track else "" for track in detections.track_ids]
