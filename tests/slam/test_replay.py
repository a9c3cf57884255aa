"""Replay: what is in the output, and what becomes of it when something fails on the way."""

import json
import shutil

import numpy as np
import pytest

from logs.digest import file_sha256
from logs.errors import LogError, TopicSelectionError
from logs.importers.imported_log import write_drive
from logs.importers.text_log import read_text_log
from logs.messages import (
    DetectionAssociations,
    FactorGraphRecord,
    ObjectDetections,
    ObjectMapRecord,
    Odometry,
    SlamPose,
    StatusRecord,
    TrajectoryRecord,
    Transform,
)
from logs.reader import LogReader
from slam.common.config import Config
from slam.common.errors import SlamError
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.replay import replay
from slam.system import Slam
from tests.helpers.data import KITTI, needs_kitti
from tests.helpers.short_drives import (
    change,
    final_status,
    keep_until,
    metadata_of,
    odometry_of,
    raw_messages,
    records_of,
    write_log,
)
from tests.tools import runs

KINDS = {
    "/slam/pose": SlamPose,
    "/slam/associations": DetectionAssociations,
    "/slam/trajectory_stamped": TrajectoryRecord,
    "/slam/map": ObjectMapRecord,
    "/slam/graph": FactorGraphRecord,
    "/slam/status": StatusRecord,
}
PICTURES = {
    "/slam/landmarks": "foxglove.SceneUpdate",
    "/slam/pose": "foxglove.PoseInFrame",
    "/tf": "foxglove.FrameTransforms",
    "/slam/log": "foxglove.Log",
    "/slam/landmark_points": "foxglove.PointCloud",
    "/slam/submap": "foxglove.PointCloud",
}


def test_the_output_topics_are_there_and_decode(noisy_output):
    for topic, kind in KINDS.items():
        assert {type(record) for record in records_of(noisy_output, topic)} == {kind}, topic
    with LogReader(noisy_output) as reader:
        schemas = {info.topic: info.schema_name for info in reader.topics()}
    assert schemas.items() >= PICTURES.items()


def test_the_output_fits_its_input(noisy_drive, noisy_output):
    odometry = odometry_of(noisy_drive)
    (trajectory,) = records_of(noisy_output, "/slam/trajectory_stamped")
    assert trajectory.stamps_ns.tolist() == [o.stamp_ns for o in odometry]
    assert trajectory.frame_id == "map"
    scans = [record for _, _, record in noisy_drive if isinstance(record, ObjectDetections)]
    associations = records_of(noisy_output, "/slam/associations")
    assert [a.stamp_ns for a in associations] == [scan.stamp_ns for scan in scans]
    assert [len(a.landmark_ids) for a in associations] == [len(scan.labels) for scan in scans]
    (object_map,) = records_of(noisy_output, "/slam/map")
    (graph,) = records_of(noisy_output, "/slam/graph")
    assert set(graph.observation_landmark_ids) <= set(object_map.ids)
    assert set(graph.keyframe_stamps_ns.tolist()) <= set(trajectory.stamps_ns.tolist())


def test_keyframes_of_the_graph_lie_on_the_trajectory(noisy_output):
    (trajectory,) = records_of(noisy_output, "/slam/trajectory_stamped")
    (graph,) = records_of(noisy_output, "/slam/graph")
    rows = np.searchsorted(trajectory.stamps_ns, graph.keyframe_stamps_ns)
    np.testing.assert_allclose(trajectory.T_map_body[rows], graph.T_map_body, atol=1e-9)


def test_odometry_truth_and_chosen_topics_are_copied_bit_for_bit(noisy_log, noisy_output, tmp_path):
    copied = ("/odom", "/detections", "/ground_truth", "/ground_truth/detections", "/ground_truth/objects")

    def content(path):
        return [
            (raw.topic, raw.log_time_ns, raw.publish_time_ns, raw.sequence, raw.data, raw.channel.schema.data)
            for raw in raw_messages(path)
            if raw.topic in copied
        ]

    assert {topic for topic, *_ in content(noisy_output)} == set(copied)
    assert content(noisy_output) == content(noisy_log)
    with pytest.raises(TopicSelectionError, match="no topic /camera to copy"):
        replay(noisy_log, tmp_path / "out.mcap", Config(), copy=["/camera"])


def test_the_output_says_what_it_was_made_from(noisy_log, noisy_output):
    found = metadata_of(noisy_output)["dslam"]
    assert found["input_sha256"] == file_sha256(noisy_log)
    assert Config.model_validate_json(found["configuration"]) == Config()
    assert json.loads(found["estimated"])
    assert found["version"]
    assert json.loads(found["topics"])["/odom"] == ["odometry"]


def test_the_summary_agrees_with_the_output(noisy_replay):
    summary, status = noisy_replay.summary, final_status(noisy_replay.output)
    assert summary.counters == status.counters
    assert summary.final_status == status.message
    assert summary.log_s == pytest.approx(summary.counters["odometry_used"] * 0.1, abs=0.2)
    assert summary.wall_s > 0.0


class PowerCutError(RuntimeError):
    """Something that nobody expects."""


@pytest.mark.slow
@pytest.mark.parametrize("error", [SlamError("broken"), PowerCutError("power cut")])
def test_an_error_on_the_way_leaves_no_file_under_the_final_name(noisy_log, tmp_path, monkeypatch, error):
    """A refusal leaves nothing, another error a part that can be read."""
    process, calls = Slam.process, iter(range(10**6))

    def failing(self, record):
        if next(calls) > 300:
            raise error
        return process(self, record)

    monkeypatch.setattr(Slam, "process", failing)
    output = tmp_path / "out.mcap"
    with pytest.raises(type(error)):
        replay(noisy_log, output, Config(calibrate=False))
    assert not output.exists()
    part = tmp_path / "out.mcap.part"
    assert part.exists() == isinstance(error, PowerCutError)
    assert not part.exists() or len(records_of(part, "/slam/pose")) > 100


def test_the_input_is_not_overwritten(noisy_drive, tmp_path):
    """Nor is what a killed run left: replay out.mcap.part -o out.mcap."""
    source, link = write_log(tmp_path / "out.mcap.part", keep_until(noisy_drive, 2.0)), tmp_path / "link.mcap"
    before = source.read_bytes()
    link.symlink_to(source)
    for output in (source, link, tmp_path / "out.mcap"):
        with pytest.raises(LogError, match="overwrite the input"):
            replay(source, output, Config())
    assert source.read_bytes() == before


def test_transform_that_comes_last_is_known_from_the_beginning(tmp_path):
    late = Transform(3 * 10**9, "base_link", "lidar", np.eye(4))
    source = runs.write_drive(tmp_path / "in.mcap", transforms=(late,), frame_id="lidar")
    assert replay(source, tmp_path / "out.mcap", Config(calibrate=False)).counters["detections_used"] == 30


def test_progress_rises_from_zero_to_one(noisy_replay):
    told = noisy_replay.progress
    assert told == sorted(told)
    assert told[0] == pytest.approx(0.0, abs=0.01)
    assert told[-1] == 1.0


def test_progress_stays_within_its_bounds_where_the_truth_is_longer_than_the_drive(noisy_drive, tmp_path):
    entries = keep_until(noisy_drive, 4.0)
    first_ns = entries[0][1]

    def middle(_, record):
        return record if 10**9 < record.stamp_ns - first_ns < 3 * 10**9 else None

    source = write_log(tmp_path / "in.mcap", change(change(entries, Odometry, middle), ObjectDetections, middle))
    told: list[float] = []
    replay(source, tmp_path / "out.mcap", Config(), progress=told.append)
    assert min(told) >= 0.0
    assert max(told) <= 1.0


@pytest.mark.slow
@needs_kitti
def test_the_first_half_minute_of_a_real_drive_is_as_good_as_its_odometry(tmp_path):
    times = [float(line) for line in (KITTI / "KITTI_00_gt_times.txt").read_text().split()]
    end_ns = round(times[300] * 1e9)
    shutil.unpack_archive(KITTI / "gosmatch_00.tar.xz", tmp_path, filter="data")
    recorded = read_text_log(
        detections=tmp_path / "00",
        odometry=KITTI / "KITTI_00_SPTAM.txt",
        calib=KITTI / "calib.txt",
        times=KITTI / "KITTI_00_gt_times.txt",
        ground_truth=KITTI / "KITTI_00_gt.txt",
    )
    first_ns = recorded.odometry.stamps_ns[0]
    records = [record for record in recorded.records() if record.stamp_ns - first_ns < end_ns - round(times[0] * 1e9)]
    write_drive(tmp_path / "in.mcap", records, recorded.source)
    replay(tmp_path / "in.mcap", tmp_path / "out.mcap", Config())
    found = evaluate(read_records(tmp_path / "out.mcap"))
    assert found.results["counters"]["odometry_used"] == 300
    # The odometry runs ahead by a scan, and is moved: the first scans come before it.
    assert found.results["counters"]["detections_used"] >= 297
    assert found.results["counters"]["landmarks_confirmed"] > 50
    assert found.estimate.ate_m < 1.05 * found.odometry.ate_m
