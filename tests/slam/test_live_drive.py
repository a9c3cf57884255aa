"""A drive mapped message by message, as it comes from a stream."""

from __future__ import annotations

from collections import Counter
from io import BytesIO
from pathlib import Path

import numpy as np

from logs.messages import LocalizationRecord, ObjectDetections, Record, SlamPose
from logs.storage.stream import read_stream, write_stream
from slam.common.config import Config
from slam.evaluation.inputs.records import read_records
from slam.live_drive import LiveDrive
from slam.simulation.config import SimulationConfig
from tests.helpers.short_drives import drive, keep_until

SECONDS = 4.0


def stream_of_a_drive() -> tuple[BytesIO, int]:
    """A stream, and how many scans it holds."""
    stream, scans = BytesIO(), 0
    for topic, log_time_ns, record in keep_until(drive(SimulationConfig()), SECONDS):
        if not topic.startswith("/ground_truth"):
            write_stream(stream, topic, record, log_time_ns)
            scans += isinstance(record, ObjectDetections)
    stream.seek(0)
    return stream, scans


def test_what_becomes_known_is_published_and_written(tmp_path: Path) -> None:
    published: list[tuple[str, Record, int]] = []
    stream, scans = stream_of_a_drive()
    with LiveDrive(Config(), lambda *each: published.append(each), output=tmp_path / "out.mcap") as live:
        for item in read_stream(stream, Counter()):
            live.process(item)
        final = live.finish()
    poses = [record for topic, record, _ in published if topic == "/slam/pose"]
    written = read_records(tmp_path / "out.mcap")
    assert [each.stamp_ns for each in written.online_poses] == [
        each.stamp_ns for each in poses if isinstance(each, SlamPose)
    ]
    assert written.status is not None
    assert written.status.message == final.status.message
    found = [record for topic, record, _ in published if topic == "/slam/localization"]
    assert len({record.stamp_ns for record in found}) == scans
    assert {"/tf", "/slam/map", "/slam/status"} <= {topic for topic, _, _ in published}


def test_each_scan_tells_how_well_the_robot_knows_its_pose() -> None:
    published: list[LocalizationRecord] = []
    stream, _ = stream_of_a_drive()
    with LiveDrive(Config(), lambda _, record, __: published.append(record)) as live:
        for item in read_stream(stream, Counter()):
            live.process(item)
        latency_s = live.latency_s()
    found = [record for record in published if isinstance(record, LocalizationRecord)]
    ratios = np.array([record.innovation_ratios for record in found])
    assert found[0].sources == ("odometry", "detections")
    assert np.median(ratios, axis=0).max() < 0.5  # as of filters that are right
    assert max(record.lost_probability for record in found) < 0.01
    covariance = found[-1].covariance
    assert covariance is not None
    assert np.linalg.eigvalsh(covariance).min() >= 0.0
    assert 0.0 < latency_s["p50"] <= latency_s["p99"] <= latency_s["max"]
