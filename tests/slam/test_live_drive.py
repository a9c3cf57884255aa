"""A drive mapped message by message, as it comes from a stream."""

from collections import Counter
from pathlib import Path

import numpy as np

from logs.messages import LocalizationRecord, ObjectDetections, Record, SlamPose
from logs.storage.stream import read_stream
from slam.common.config import Config
from slam.evaluation.inputs.records import read_records
from slam.live_drive import map_live
from slam.simulation.config import SimulationConfig
from tests.helpers.short_drives import drive, keep_until, stream_of

SECONDS = 4.0


def test_what_becomes_known_is_published_and_written(tmp_path: Path) -> None:
    published: list[tuple[str, Record, int]] = []
    entries = keep_until(drive(SimulationConfig()), SECONDS)
    stream = stream_of(each for each in entries if not each[0].startswith("/ground_truth"))
    counters = Counter[str]()
    final, mapper = map_live(
        read_stream(stream, counters),
        counters,
        Config(),
        lambda *each: published.append(each),
        output=tmp_path / "out.mcap",
    )
    latency_s = mapper.latency_s()
    assert 0.0 < latency_s["p50"] <= latency_s["p99"] <= latency_s["max"]
    poses = [record.stamp_ns for _, record, _ in published if isinstance(record, SlamPose)]
    written = read_records(tmp_path / "out.mcap")
    assert written.online_path.stamps_ns.tolist() == poses
    assert written.statuses[-1].message == final.status.message
    assert {"/tf", "/slam/map", "/slam/status"} <= {topic for topic, _, _ in published}
    found = [record for _, record, _ in published if isinstance(record, LocalizationRecord)]
    scans = {record.stamp_ns for *_, record in entries if isinstance(record, ObjectDetections)}
    assert {record.stamp_ns for record in found} == scans
    ratios = np.array([record.innovation_ratios for record in found])
    assert found[0].sources == ("odometry", "detections")
    assert np.median(ratios, axis=0).max() < 0.5  # as of filters that are right
    assert max(record.lost_probability for record in found) < 0.01
    covariance = found[-1].covariance
    assert np.linalg.eigvalsh(covariance).min() >= 0.0
