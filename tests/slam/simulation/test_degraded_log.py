from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs.errors import TopicSelectionError
from logs.messages import (
    DetectionTruth,
    ObjectDetections,
    Odometry,
    Record,
    Transform,
)
from logs.reader import LogReader
from slam.common.errors import SimulationError
from slam.common.geometry import invert, transform_from_xyz_yaw, yaw_rad
from slam.simulation.degradation import (
    DegradationConfig,
)
from slam.simulation.degraded_log import write_degraded
from tests.slam.simulation.degraded import (
    COUNT,
    EACH,
    PERIOD_NS,
    SCANS,
    START_NS,
    T_BODY_SENSOR,
    assert_true_ids_fit,
    degrade,
    drive,
    raw_messages,
    read,
    scan,
    tracks,
    write,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("log") / "log.mcap", drive(rng=np.random.default_rng(11)))


@pytest.fixture(scope="module")
def before(log: Path) -> dict[str, list[Any]]:
    return read(log)


class TestTimeAndOdometry:
    def test_time_offset_shifts_detections_and_their_truth(self, log: Path, before: dict[str, list[Any]]) -> None:
        after = degrade(log, time_offset_s=-0.25).records
        for topic in ("/detections", "/ground_truth/detections"):
            assert [r.stamp_ns + 250_000_000 for r in after[topic]] == [r.stamp_ns for r in before[topic]]
        for topic in ("/odom", "/ground_truth"):
            assert [r.stamp_ns for r in after[topic]] == [r.stamp_ns for r in before[topic]]
        assert_true_ids_fit(after)

    def test_stamps_before_zero_are_left_out_and_told(self, log: Path) -> None:
        degraded = degrade(log, time_offset_s=-6.0)
        assert degraded.summary.left_out == {"stamps_before_zero": 20}
        assert_true_ids_fit(degraded.records)

    def test_odometry_drifts_with_the_root_of_the_travel(self, log: Path, before: dict[str, list[Any]]) -> None:
        T_gt = np.array([r.T_odom_body for r in before["/odom"]])
        steps_gt = invert(T_gt[:-1]) @ T_gt[1:]
        root_m = np.sqrt(np.linalg.norm(steps_gt[:, :3, 3], axis=1))
        xyz, yaw = [], []
        for seed in range(3):
            after = degrade(log, seed=seed, odometry_translation_noise=0.1, odometry_yaw_noise=0.02)
            T = np.array([r.T_odom_body for r in after.records["/odom"]])
            assert T[0] == pytest.approx(T_gt[0])
            steps = invert(T[:-1]) @ T[1:]
            xyz.append((steps - steps_gt)[:, :3, 3] / root_m[:, None])
            yaw.append(yaw_rad(invert(steps_gt) @ steps) / root_m)
        count = 3 * (SCANS - 1)
        assert np.std(np.concatenate(xyz), axis=0) == pytest.approx(np.full(3, 0.1), abs=4 * 0.1 / np.sqrt(2 * count))
        assert np.std(np.concatenate(yaw)) == pytest.approx(0.02, abs=4 * 0.02 / np.sqrt(2 * count))

    def test_odometry_alone_leaves_the_rest_as_it_stands(self, log: Path) -> None:
        degraded = degrade(log, odometry_yaw_noise=0.02)
        rest = ("/detections", "/ground_truth", "/ground_truth/detections", "/tf_static", "/status")
        assert raw_messages(degraded.path, *rest) == raw_messages(log, *rest)
        assert degraded.summary.counts["kept"] == COUNT

    def test_reversed(self, log: Path, before: dict[str, list[Any]]) -> None:
        degraded = degrade(log, reversed=True)
        after = degraded.records
        for topic in ("/odom", "/detections", "/ground_truth", "/ground_truth/detections"):
            assert [r.stamp_ns for r in after[topic]] == [r.stamp_ns for r in before[topic]]
        for old, new in zip(before["/odom"], reversed(after["/odom"]), strict=True):
            assert new.T_odom_body == pytest.approx(old.T_odom_body)
        for old, new in zip(before["/ground_truth"], reversed(after["/ground_truth"]), strict=True):
            assert new.T_world_body == pytest.approx(old.T_world_body)
        assert tracks(after)[:EACH] == tracks(before)[-EACH:]
        assert_true_ids_fit(after)
        assert raw_messages(degraded.path, "/tf_static") == raw_messages(log, "/tf_static")
        # What cannot be reversed is told.
        assert degraded.summary.left_out == {"irreversible_messages": 1}
        assert degraded.summary.counts["kept"] == COUNT

    def test_reversed_odometry_drifts_from_where_it_begins(self, log: Path, before: dict[str, list[Any]]) -> None:
        after = degrade(log, reversed=True, odometry_translation_noise=0.1).records
        assert after["/odom"][0].T_odom_body == pytest.approx(before["/odom"][-1].T_odom_body)
        assert after["/odom"][-1].T_odom_body != pytest.approx(before["/odom"][0].T_odom_body, abs=1e-3)

    def test_reversed_twice_is_the_log_itself(self, log: Path, tmp_path: Path) -> None:
        once, twice = tmp_path / "once.mcap", tmp_path / "twice.mcap"
        write_degraded(log, once, DegradationConfig(reversed=True), seed=0)
        write_degraded(once, twice, DegradationConfig(reversed=True), seed=0)
        topics = ("/odom", "/detections", "/ground_truth", "/ground_truth/detections", "/tf_static")
        assert [m[:2] for m in raw_messages(twice, *topics)] == [m[:2] for m in raw_messages(log, *topics)]
        assert raw_messages(twice, "/detections") == raw_messages(log, "/detections")
        assert raw_messages(once, "/detections") != raw_messages(log, "/detections")

    def test_only_frames_that_move_are_reversed(self, tmp_path: Path) -> None:
        records = drive(rng=np.random.default_rng(5))
        for i in range(3):
            T = transform_from_xyz_yaw(np.array([1.0 * i, 0.0, 0.0]), 0.0)
            records.append(("/tf", Transform(START_NS + i * PERIOD_NS, "odom", "base_link", T)))
        records.append(("/tf", Transform(START_NS, "base_link", "camera", T_BODY_SENSOR)))
        source = write(tmp_path / "log.mcap", records)
        x = {
            r.stamp_ns: r.T_parent_child[0, 3]
            for r in degrade(source, reversed=True).records["/tf"]
            if r.child_frame_id != "camera"
        }
        last_ns = START_NS + (SCANS - 1) * PERIOD_NS
        assert x == {last_ns - i * PERIOD_NS: float(i) for i in range(3)}
        still = [r.stamp_ns for r in degrade(source, reversed=True).records["/tf"] if r.child_frame_id == "camera"]
        assert still == [START_NS]


class TestOutput:
    def test_same_input_and_seed_same_bytes(self, log: Path) -> None:
        options: dict[str, Any] = {
            "dropout": 0.2, "position_noise_m": 0.1, "label_confusion": 0.1, "false_positives": 2.0,
            "odometry_yaw_noise": 0.01, "time_offset_s": 0.01, "reversed": True,
        }  # fmt: skip
        first = degrade(log, **options).path.read_bytes()
        assert degrade(log, **options).path.read_bytes() == first
        assert degrade(log, seed=1, **options).path.read_bytes() != first

    def test_metadata_tells_how_it_was_made_however_often(self, log: Path, tmp_path: Path) -> None:
        path = degrade(log, seed=4, dropout=0.2, keep_labels=("lamp",)).path
        again = tmp_path / "again.mcap"
        write_degraded(path, again, DegradationConfig(max_range_m=10.0), seed=0)
        with LogReader(again) as reader, LogReader(log) as original, LogReader(path) as first:
            metadata = reader.metadata()
            assert metadata["source"] == {"dataset": "made up"}
            made = metadata["degradation"]
            assert (json.loads(made["dropout"]), json.loads(made["keep_labels"]), made["seed"]) == (0.2, ["lamp"], "4")
            assert made["input_sha256"] == original.sha256()
            assert "version" in made
            assert metadata["degradation_2"]["max_range_m"] == "10.0"
            assert metadata["degradation_2"]["input_sha256"] == first.sha256()

    def test_nothing_to_change_copies(self, log: Path) -> None:
        assert raw_messages(degrade(log, dropout=0.0).path) == raw_messages(log)

    def test_truth_of_other_detections_is_left_out_and_told(self, tmp_path: Path) -> None:
        records = drive(rng=np.random.default_rng(5))
        records = [
            (topic, replace(r, object_ids=r.object_ids[1:]))
            if isinstance(r, DetectionTruth) and r.stamp_ns == START_NS
            else (topic, r)
            for topic, r in records
        ]
        records.append(("/ground_truth/detections", DetectionTruth(START_NS + 1, ("a",))))
        degraded = degrade(write(tmp_path / "log.mcap", records), dropout=0.1)
        assert degraded.summary.left_out == {"true_ids_of_other_detections": 1, "true_ids_without_detections": 1}


class TestRefusals:
    def test_logs_without_what_is_needed(self, tmp_path: Path) -> None:
        nothing = ObjectDetections(0, "base_link", np.zeros((0, 3)), (), np.zeros(0))
        one = scan(0, np.random.default_rng(0), frame="odom")
        odometry = Odometry(0, np.eye(4))
        cases: tuple[tuple[list[tuple[str, Record]], dict[str, Any], str], ...] = (
            ([("/odom", odometry)], {"dropout": 0.1}, "no topic gives detections"),
            ([("/odom", odometry), ("/detections", nothing)], {"dropout": 0.1}, "no object is detected"),
            ([("/detections", one)], {"reversed": True}, "no topic gives odometry"),
            ([("/odom", odometry), ("/detections", one)], {"max_range_m": 9.0}, "frame of the odometry"),
        )
        for records, options, told in cases:
            source = write(tmp_path / "log.mcap", records)
            with pytest.raises((SimulationError, TopicSelectionError), match=told):
                degrade(source, **options)
            assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]

    def test_no_false_positives_without_a_model(self, log: Path) -> None:
        with pytest.raises(SimulationError, match="widen the view"):
            degrade(log, false_positives=1.0, max_range_m=1e-6)
