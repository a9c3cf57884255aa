"""What viewers hold at any time of a log is the map of that time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.errors import TopicSelectionError
from logs.messages import GroundTruthPose, LoopClosureRecord, SlamPose, Transform
from logs.reader import LogReader
from logs.selection import select_topics
from slam.common.config import Config
from slam.common.geometry import transform_from_xyz_yaw
from slam.display.drive_display import DriveDisplay
from slam.display.frames import Frames
from slam.display.map_topics import LANDMARK_POINTS, LANDMARKS, SMALL_MAP, MapTopics
from slam.display.snapshot import MapSnapshot
from slam.object_map.landmarks import LandmarkState
from slam.replay import replay
from slam.simulation.config import OdometryConfig, SimulationConfig
from slam.system import Slam
from tests.helpers.player import Player
from tests.helpers.short_drives import drive, write_log

CONFIG = Config(calibrate=False)
TOLERANCE_M = 0.05


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("display")
    drifting = SimulationConfig(odometry=OdometryConfig(scale_drift_percent=2.0, heading_drift_deg_per_100m=4.0))
    source = write_log(folder / "drive.mcap", drive(drifting))
    replay(source, folder / "map.mcap", CONFIG)
    return source, folder / "map.mcap"


def time_at(path: Path, fraction: float) -> int:
    with LogReader(path) as reader:
        (info,) = [info for info in reader.topics() if info.topic == "/odom"]
    return round(info.first_log_time_ns + fraction * (info.last_log_time_ns - info.first_log_time_ns))


def map_at(source: Path, until_ns: int) -> dict[str, np.ndarray]:
    """Confirmed landmarks of an estimator that got the drive only so far, at its last keyframe."""
    slam, latest = Slam(CONFIG), {}
    with LogReader(source) as reader:
        for item in reader.items(select_topics(reader.topics())):
            if item.raw.log_time_ns > until_ns:
                break
            for record in item.records:
                if not isinstance(record, GroundTruthPose):
                    slam.process(record)
                if slam.snapshot() is not None:
                    found = slam._graph.estimates()
                    rows = np.isin(found.landmarks, slam._object_map.in_state(LandmarkState.CONFIRMED))
                    names = map(str, found.landmarks[rows])
                    latest = dict(zip(names, found.landmark_positions[rows], strict=True))
    return latest


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.3, 0.6, 0.95])
def test_a_player_holds_the_map_of_that_time(logs, fraction):
    source, output = logs
    at_ns = time_at(source, fraction)
    expected = map_at(source, at_ns)
    assert len(expected) >= 5
    shown = Player.played(output, at_ns).positions(LANDMARKS)
    assert shown.keys() == expected.keys()
    for name, position in expected.items():
        assert np.linalg.norm(shown[name] - position) < TOLERANCE_M, name


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.3, 0.6, 0.95])
def test_viewer_has_whole_map_after_seek(logs, fraction):
    source, output = logs
    at_ns = time_at(source, fraction)
    expected = np.array(list(map_at(source, at_ns).values()))
    player = Player.after_seek(output, at_ns)
    distances = np.linalg.norm(player.clouds[LANDMARK_POINTS][:, None] - expected, axis=2)
    assert (distances.min(axis=1) < TOLERANCE_M).all()
    newer = len(expected) - len(player.clouds[LANDMARK_POINTS])
    assert 0 <= newer <= 0.35 * len(expected)
    assert player.entities["/slam/path"]["lines"].lines
    assert len(player.clouds["/slam/submap"]) > 3
    assert player.parents == {"map": "world", "odom": "map", "base_link": "odom"}


@pytest.mark.slow
def test_the_status_is_told_as_text(logs):
    first, last = Player.played(logs[1], 2**62).texts
    assert first == "mapping: first odometry"
    assert last.startswith("mapping: optimised")


def test_closures_are_shown_as_lines():
    closures = np.array([[[0.0, 0, 0], [8.0, 0, 0]]])
    messages = dict(MapTopics(30.0).update(replace(snapshot(0, {}), closures=closures)))
    np.testing.assert_array_equal(messages["/slam/closure_lines"].polylines, closures)


@pytest.mark.slow
def test_chosen_topics_are_copied(logs, tmp_path):
    source, _ = logs
    with pytest.raises(TopicSelectionError, match="no topic /camera to copy"):
        replay(source, tmp_path / "out.mcap", CONFIG, copy=["/camera"])
    replay(source, tmp_path / "out.mcap", CONFIG, copy=["/detections"])
    with LogReader(source) as first, LogReader(tmp_path / "out.mcap") as second:
        copied = [raw.data for raw in second.messages(["/detections"])]
        assert copied == [raw.data for raw in first.messages(["/detections"])]
    assert copied


def snapshot(stamp_s: float, positions: dict[int, list[float]]) -> MapSnapshot:
    return MapSnapshot(
        stamp_ns=round(stamp_s * 1e9),
        path=(np.zeros((2, 3)),),
        closures=np.zeros((0, 2, 3)),
        landmarks=np.array(sorted(positions), dtype=np.int64),
        positions=np.array([positions[key] for key in sorted(positions)]).reshape(-1, 3),
        labels=("tree",) * len(positions),
        submap=np.array(sorted(positions), dtype=np.int64),
    )


def markers(messages):
    return [record for topic, record in messages if topic == LANDMARKS]


def test_only_what_changed_is_told():
    topics = MapTopics(30.0)
    (first,) = markers(topics.update(snapshot(0, {1: [0.0, 0, 0], 2: [5.0, 0, 0]})))
    assert (first.ids, first.removed, first.replaces) == (("1", "2"), (), False)
    assert markers(topics.update(snapshot(1, {1: [0.005, 0, 0], 2: [5.0, 0, 0]}))) == []
    (moved,) = markers(topics.update(snapshot(2, {1: [0.3, 0, 0], 7: [9.0, 0, 0]})))
    assert (moved.ids, moved.removed) == (("1", "7"), ("2",))
    (last,) = markers(topics.update(snapshot(3, {1: [0.3, 0, 0]}), is_final=True))
    assert (last.ids, last.replaces) == (("1",), True)


@pytest.mark.parametrize(
    ("after", "written"),
    [
        (snapshot(1, {1: [0.0, 0, 0], 2: [5.0, 0, 0]}), set()),
        (snapshot(6, {1: [0.0, 0, 0], 2: [5.0, 0, 0]}), {LANDMARK_POINTS, "/slam/path"}),
        (snapshot(1, {1: [0.0, 0, 0]}), {LANDMARK_POINTS}),
        (snapshot(1, {1: [0.0, 0, 0], 2: [5.5, 0, 0]}), {LANDMARK_POINTS}),
    ],
    ids=["nothing", "time", "retired", "moved"],
)
def test_the_whole_map_is_written_when_it_is_due(after, written):
    topics = MapTopics(30.0)
    topics.update(snapshot(0, {1: [0.0, 0, 0], 2: [5.0, 0, 0]}))
    assert {LANDMARK_POINTS, "/slam/path"} & dict(topics.update(after)).keys() == written


def test_the_whole_map_is_written_after_a_closure():
    display = DriveDisplay(30.0)
    display.show_map(snapshot(0, {1: [0.0, 0, 0]}))
    assert "/slam/path" not in dict(display.show_map(snapshot(1, {1: [0.0, 0, 0]})))
    closure = LoopClosureRecord(
        2, 8, 3, accepted=True, stage="accepted", reason="", retrieval_distance=0.0, inserted=True
    )
    ((topic, told),) = display.show(closure)
    assert (topic, told.text) == ("/slam/log", "loop closed: keyframe 8 with 3")
    assert "/slam/path" in dict(display.show_map(snapshot(2, {1: [0.0, 0, 0]})))
    assert "/slam/path" not in dict(display.show_map(snapshot(3, {1: [0.0, 0, 0]})))


@pytest.mark.parametrize("is_closed", [False, True])
def test_a_large_map_is_written_more_seldom(is_closed):
    large = {key: [float(key), 0.0, 0.0] for key in range(4 * SMALL_MAP)}
    topics = MapTopics(30.0)
    topics.update(snapshot(0, large))
    due_s = 20 - 5 * is_closed
    assert "/slam/path" not in dict(topics.update(snapshot(due_s - 1, large), is_closed=is_closed))
    assert "/slam/path" in dict(topics.update(snapshot(due_s + 1, large), is_closed=is_closed))


def test_world_frame_is_tied_at_first_common_pose():
    truths = [GroundTruthPose(t, transform_from_xyz_yaw(np.array([10.0 + t, 0.0, 0.0]), 0.0)) for t in (10, 20, 30)]
    frames = Frames(truths)
    frames.add(Transform(0, "odom", "base_link", np.eye(4)))
    frames.tie(SlamPose(5, np.eye(4)))
    assert [each.child_frame_id for each in frames.tree(5).transforms] == ["base_link"]
    frames.tie(SlamPose(15, transform_from_xyz_yaw(np.array([1.0, 0.0, 0.0]), 0.0)))
    (_, tie) = frames.tree(15).transforms
    assert (tie.parent_frame_id, tie.child_frame_id) == ("world", "map")
    np.testing.assert_allclose(tie.T_parent_child[:3, 3], [24.0, 0.0, 0.0])


def test_a_robot_that_is_lost_is_not_in_the_map():
    frames = Frames()
    frames.add(Transform(0, "map", "odom", np.eye(4)))
    frames.add(Transform(0, "odom", "base_link", np.eye(4)))
    frames.detach_from_map()
    assert [each.parent_frame_id for each in frames.tree(1).transforms] == ["odom"]
