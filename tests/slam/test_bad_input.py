"""Whatever is wrong with the input or the output: one clear error of ours, or the drive is mapped and what was lost is
counted in the final status of the output. Any other exception fails the test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry as FoxgloveOdometry

from logs.container.limits import ReadingLimits
from logs.errors import TopicSelectionError, UnreadableLogError, UnwritableLogError
from logs.messages import ObjectDetections, Odometry, Record, Transform
from logs.reader import LogReader
from logs.storage.mcap_index import read_index
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.common.geometry import transform_from_xyz_yaw
from slam.replay import ReplaySummary, replay
from tests.helpers.short_drives import (
    Entry,
    change,
    final_status,
    in_frame,
    keep_until,
    raw_messages,
    records_of,
    replay_or_refuse,
    write_log,
    write_raw,
)

pytestmark = pytest.mark.slow

SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module")
def entries(noisy_drive: list[Entry]) -> list[Entry]:
    """Eight seconds, 80 odometry messages and 80 scans."""
    return keep_until(noisy_drive, 8.0)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "out.mcap"


def mapped(entries: list[Entry], output: Path, config: Config | None = None) -> dict[str, int]:
    """Counters of the final status, after a replay that must succeed and leave sound numbers."""
    replay(write_log(output.with_name("in.mcap"), entries), output, config or Config())
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    (object_map,) = records_of(output, "/slam/map")
    assert np.isfinite(trajectory.T_map_body).all()
    assert np.isfinite(object_map.positions).all()
    return final_status(output).counters


# The file


@pytest.mark.parametrize("content", [b"", b"x,y,z\n1,2,3\n", b"\x89MCA"], ids=["empty", "text", "four bytes"])
def test_what_is_no_log_is_refused(tmp_path, output, content):
    source = tmp_path / "in.mcap"
    source.write_bytes(content)
    with pytest.raises(UnreadableLogError, match=r"in\.mcap"):
        replay(source, output, Config())
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize("name", ["missing.mcap", "."])
def test_what_is_no_file_is_refused(tmp_path, output, name):
    with pytest.raises(UnreadableLogError, match="cannot read"):
        replay(tmp_path / name, output, Config())


def test_a_log_without_messages_is_refused(output):
    with pytest.raises(TopicSelectionError, match="no topics"):
        mapped([], output)


@pytest.mark.parametrize("seed", range(10))
def test_a_truncated_log_is_mapped_as_far_as_it_goes_or_refused(noisy_log, tmp_path, output, seed):
    whole = noisy_log.read_bytes()
    source = tmp_path / "in.mcap"
    source.write_bytes(whole[: int(np.random.default_rng(seed).integers(0, len(whole)))])
    result = replay_or_refuse(source, output)
    if isinstance(result, ReplaySummary):
        assert result.counters["truncated"] == 1
        assert 0 < result.counters["odometry_used"] <= 304


def test_a_truncated_log_is_mapped_where_a_chunk_is_left(noisy_log, tmp_path, output):
    whole = noisy_log.read_bytes()
    source = tmp_path / "in.mcap"
    source.write_bytes(whole[: 3 * len(whole) // 4])
    result = replay_or_refuse(source, output)
    assert isinstance(result, ReplaySummary)
    assert 50 < result.counters["odometry_used"] < 304


def test_a_chunk_with_a_bad_checksum_is_left_out_and_counted(noisy_log, tmp_path, output):
    damaged = bytearray(noisy_log.read_bytes())
    with open(noisy_log, "rb") as stream:
        chunks = read_index("", stream, len(damaged), ReadingLimits()).blocks
    assert len(chunks) > 1
    damaged[chunks[1].offset + 33] ^= 0xFF
    source = tmp_path / "in.mcap"
    source.write_bytes(damaged)
    result = replay_or_refuse(source, output)
    assert isinstance(result, ReplaySummary)
    assert result.counters["lost_chunks"] == 1
    assert result.counters["lost_bytes"] > 0
    assert result.counters["odometry_used"] < 304


def test_garbage_anywhere_is_counted_or_refused(noisy_log, tmp_path, output):
    rng = np.random.default_rng(5)
    whole = noisy_log.read_bytes()
    undamaged = replay(noisy_log, output, Config())
    source = tmp_path / "in.mcap"
    for _ in range(5):
        damaged = bytearray(whole)
        start = int(rng.integers(8, len(damaged) - 3000))
        damaged[start : start + 2000] = rng.bytes(2000)
        source.write_bytes(damaged)
        outcome = replay_or_refuse(source, output)
        if isinstance(outcome, ReplaySummary):
            told = {"lost_chunks", "lost_bytes", "truncated", "invalid_messages"} & set(outcome.counters)
            # Where nothing is told, nothing is lost: the garbage hit what can be had from elsewhere, as an index can.
            assert told or outcome.counters == undamaged.counters
        output.unlink(missing_ok=True)


def test_an_input_that_vanishes_is_told(noisy_log, tmp_path, output, monkeypatch):
    source = tmp_path / "in.mcap"
    source.write_bytes(noisy_log.read_bytes())
    topics = LogReader.topics

    def vanishing(self: LogReader):
        source.unlink(missing_ok=True)
        return topics(self)

    monkeypatch.setattr(LogReader, "topics", vanishing)
    with pytest.raises(UnreadableLogError, match="cannot read"):
        replay(source, output, Config())
    assert not output.exists()


# Topics


def test_without_odometry_nothing_is_mapped(entries, output):
    with pytest.raises(TopicSelectionError, match="no topic gives odometry"):
        mapped(change(entries, Odometry, lambda i, record: None), output)


def test_without_detections_nothing_is_mapped(entries, output):
    with pytest.raises(TopicSelectionError, match="no topic gives detections"):
        mapped(change(entries, ObjectDetections, lambda i, record: None), output)


@pytest.mark.parametrize(("kind", "topic"), [(Odometry, "/odom"), (ObjectDetections, "/detections")])
def test_several_topics_that_fit_are_listed(entries, output, kind, topic):
    twice = [*entries, *((topic + "2", ns, record) for _, ns, record in entries if isinstance(record, kind))]
    with pytest.raises(TopicSelectionError, match=f"{topic}, {topic}2.*--topic"):
        mapped(sorted(twice, key=lambda entry: entry[1]), output)


# Time


def shuffled(seed: int) -> Callable[[int, Record], Record]:
    """Stamps that stray by up to 0.25 s from the time at which the message was logged."""
    rng = np.random.default_rng(seed)
    return lambda i, record: replace(record, stamp_ns=record.stamp_ns + int(rng.integers(-250_000_000, 250_000_000)))


def test_odometry_out_of_order_is_left_out_and_counted(entries, output):
    counters = mapped(change(entries, Odometry, shuffled(1)), output)
    assert counters["odometry_out_of_order"] > 10
    assert counters["odometry_used"] + counters["odometry_out_of_order"] == 80


def test_detections_out_of_order_are_left_out_and_counted(entries, output):
    counters = mapped(change(entries, ObjectDetections, shuffled(2)), output)
    assert counters["detections_out_of_order"] > 10
    left_out = counters["detections_out_of_order"] + counters["detections_without_odometry"]
    assert counters["detections_used"] + left_out == 80


def repeated(entries: list[Entry], kind: type) -> list[Entry]:
    return [entry for entry in entries for _ in range(2 if isinstance(entry[2], kind) else 1)]


def test_duplicates_are_left_out_and_counted(entries, output):
    counters = mapped(repeated(entries, (Odometry, ObjectDetections)), output)
    assert counters["odometry_duplicated"] == counters["detections_duplicated"] == 80
    assert counters["odometry_used"] == counters["detections_used"] == 80


def after_a_pause(entries: list[Entry], kinds: tuple[type, ...]) -> list[Entry]:
    """What comes after four seconds comes a minute later; of ``kinds`` nothing comes in between."""
    start_ns = entries[0][1]

    def delayed(entry: Entry) -> Entry:
        topic, ns, record = entry
        if ns - start_ns < 4 * SECOND_NS:
            return entry
        return topic, ns + 60 * SECOND_NS, replace(record, stamp_ns=record.stamp_ns + 60 * SECOND_NS)

    late = [delayed(entry) for entry in entries]
    waiting = [
        ("/odom", o.stamp_ns + i * SECOND_NS // 10, replace(o, stamp_ns=o.stamp_ns + i * SECOND_NS // 10))
        for o in [
            next(e[2] for e in reversed(entries) if isinstance(e[2], Odometry) and e[1] - start_ns < 4 * SECOND_NS)
        ]
        for i in range(1, 600)
        if Odometry not in kinds
    ]
    return sorted([*late, *waiting], key=lambda entry: entry[1])


def test_a_minute_without_a_message_breaks_nothing_if_the_same_objects_are_seen_afterwards(entries, output):
    counters = mapped(after_a_pause(entries, (Odometry, ObjectDetections)), output)
    assert "odometry_breaks" not in counters
    assert counters["odometry_used"] == counters["detections_used"] == 80


def test_a_minute_without_a_message_breaks_the_track_if_other_objects_are_seen_afterwards(entries, output):
    away = np.array([3.1, 2.3, 0.0])

    def elsewhere(i, record):
        return replace(record, positions=record.positions[:, [1, 0, 2]] + away) if i >= 40 else record

    changed = change(entries, ObjectDetections, elsewhere)
    counters = mapped(after_a_pause(changed, (Odometry, ObjectDetections)), output)
    assert counters["odometry_breaks"] == 1


def test_a_minute_without_detections_while_the_body_waits_breaks_nothing(entries, output):
    counters = mapped(after_a_pause(entries, (ObjectDetections,)), output)
    assert "odometry_breaks" not in counters
    assert counters["odometry_used"] == 80 + 599
    assert counters["detections_used"] == 80


def test_a_body_that_stands_still_for_a_minute_is_mapped(entries, output):
    first = {type(record): (topic, record) for topic, _, record in reversed(entries)}
    start_ns = entries[0][1]
    still = []
    for i in range(600):
        ns = start_ns + i * SECOND_NS // 10
        still += [
            (topic, ns, replace(record, stamp_ns=ns)) for topic, record in (first[Odometry], first[ObjectDetections])
        ]
    counters = mapped(still, output)
    assert counters["detections_used"] == 600
    assert counters["keyframes"] <= 13
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    np.testing.assert_allclose(trajectory.T_map_body, np.tile(np.eye(4), (600, 1, 1)), atol=1e-3)


def test_detections_before_the_first_odometry_are_counted(entries, output):
    counters = mapped(change(entries, Odometry, lambda i, record: record if i >= 20 else None), output)
    assert counters["detections_without_odometry"] == 20
    assert counters["detections_used"] == 60


def test_odometry_that_ends_early_leaves_the_rest_of_the_detections_out(entries, output):
    counters = mapped(change(entries, Odometry, lambda i, record: record if i < 50 else None), output)
    assert counters["detections_without_odometry"] == 30
    assert counters["detections_used"] == 50


def test_a_single_odometry_message_is_a_map_of_one_keyframe(entries, output):
    counters = mapped(change(entries, Odometry, lambda i, record: record if i == 0 else None), output)
    assert counters["keyframes"] == counters["detections_used"] == 1


# Poses


def with_pose(
    entries: list[Entry], output: Path, alter: Callable[[FoxgloveOdometry], None], every: int
) -> dict[str, int]:
    """Counters of a replay in which each ``every``-th odometry message was changed as it stands in the file."""
    source = write_log(output.with_name("whole.mcap"), entries)
    messages, count = [], 0
    for raw in raw_messages(source):
        if raw.topic == "/odom":
            if count % every == every - 1:
                message = FoxgloveOdometry.FromString(raw.data)
                alter(message)
                raw = replace(raw, data=message.SerializeToString(deterministic=True))
            count += 1
        messages.append(raw)
    changed = write_raw(output.with_name("in.mcap"), messages)
    replay(changed, output, Config())
    return final_status(output).counters


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_poses_that_are_no_numbers_are_left_out_and_counted(entries, output, value):
    def alter(message: FoxgloveOdometry) -> None:
        message.pose.position.y = value

    counters = with_pose(entries, output, alter, every=8)
    assert counters["invalid_messages"] == 10
    assert counters["odometry_used"] == 70
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    assert np.isfinite(trajectory.T_map_body).all()


def scale_quaternion(factor: float) -> Callable[[FoxgloveOdometry], None]:
    def alter(message: FoxgloveOdometry) -> None:
        q = message.pose.orientation
        q.x, q.y, q.z, q.w = factor * q.x, factor * q.y, factor * q.z, factor * q.w

    return alter


def test_a_quaternion_that_was_rounded_is_used(entries, output):
    counters = with_pose(entries, output, scale_quaternion(1.005), every=1)
    assert counters["odometry_used"] == 80
    (graph,) = records_of(output, "/slam/graph")
    R = graph.T_map_body[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9)


@pytest.mark.parametrize("factor", [0.0, 0.5, 1.2])
def test_a_quaternion_that_is_none_is_left_out_and_counted(entries, output, factor):
    counters = with_pose(entries, output, scale_quaternion(factor), every=8)
    assert counters["invalid_messages"] == 10
    assert counters["odometry_used"] == 70


def test_if_no_pose_is_any_good_nothing_is_mapped(entries, output):
    with pytest.raises(InputDataError, match="no odometry message was usable"):
        with_pose(entries, output, scale_quaternion(0.0), every=1)
    assert not output.exists()


@pytest.mark.parametrize("xyz", [(1e7, -1e7, 100.0), (500_000.0, 5_400_000.0, 300.0)], ids=["1e7 m", "UTM"])
def test_huge_coordinates_give_the_same_map_elsewhere(entries, output, xyz):
    T = transform_from_xyz_yaw(np.array(xyz), 0.0)
    here = mapped(entries, output)
    (map_here,) = records_of(output, "/slam/map")
    moved = change(entries, Odometry, lambda i, record: replace(record, T_odom_body=T @ record.T_odom_body))
    there = mapped(moved, output)
    (map_there,) = records_of(output, "/slam/map")
    assert here["landmarks_confirmed"] == there["landmarks_confirmed"]
    assert map_here.ids == map_there.ids
    np.testing.assert_allclose(map_there.positions - T[:3, 3], map_here.positions, atol=0.01)


# Frames


def test_a_frame_that_no_transform_leads_to_is_named(entries, output):
    with pytest.raises(InputDataError, match="from velodyne to base_link"):
        mapped(in_frame(entries, "velodyne"), output)
    assert not output.exists()


def test_a_static_transform_leads_to_it(entries, output):
    mount = ("/tf_static", entries[0][1], Transform(entries[0][1], "base_link", "velodyne", np.eye(4)))
    counters = mapped([mount, *in_frame(entries, "velodyne")], output)
    assert counters["detections_used"] == 80


def test_or_the_configuration_says_that_it_is_the_body(entries, output):
    config = Config.model_validate({"calibration": {"detection": {"assume_body_frame": True}}})
    assert mapped(in_frame(entries, "velodyne"), output, config)["detections_used"] == 80


def test_what_came_before_its_transform_is_placed_by_it(entries, output):
    start_ns = entries[0][1]
    mount = ("/tf_static", start_ns + 2 * SECOND_NS, Transform(start_ns, "base_link", "velodyne", np.eye(4)))
    counters = mapped(sorted([*in_frame(entries, "velodyne"), mount], key=lambda entry: entry[1]), output)
    assert counters["detections_used"] == 80


# Detections


def altered_scans(
    entries: list[Entry], alter: Callable[[int, ObjectDetections], ObjectDetections | None]
) -> list[Entry]:
    return change(entries, ObjectDetections, alter)


def replaced(detections: ObjectDetections, positions, labels) -> ObjectDetections:
    positions = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    return ObjectDetections(detections.stamp_ns, detections.frame_id, positions, tuple(labels), np.ones(len(positions)))


def test_a_label_that_was_never_seen_before_joins_the_vocabulary(entries, output):
    def rename(i: int, detections: ObjectDetections) -> ObjectDetections:
        new = tuple("fire hydrant" if label == "tree" else label for label in detections.labels)
        return replace(detections, labels=new) if i >= 40 else detections

    mapped(altered_scans(entries, rename), output)
    (object_map,) = records_of(output, "/slam/map")
    assert object_map.vocabulary[-1] == "fire hydrant"
    assert set(object_map.vocabulary) == {"bench", "lamp", "tree", "vehicle", "fire hydrant"}
    np.testing.assert_allclose(object_map.class_probabilities.sum(axis=1), 1.0)


def test_messages_without_a_detection_are_scans_like_others(entries, output):
    counters = mapped(altered_scans(entries, lambda i, d: replaced(d, [], []) if i % 3 == 1 else d), output)
    assert counters["detections_used"] == 80


def test_if_nothing_is_ever_seen_the_odometry_is_the_result(entries, output):
    counters = mapped(altered_scans(entries, lambda i, d: replaced(d, [], [])), output)
    assert counters["landmarks_confirmed"] == counters["objects_used"] == 0
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    odometry = [record for _, _, record in entries if isinstance(record, Odometry)]
    np.testing.assert_allclose(trajectory.T_map_body, [o.T_odom_body for o in odometry], atol=1e-6)


def test_five_thousand_detections_in_a_message(entries, output):
    rng = np.random.default_rng(0)

    def crowd(i: int, detections: ObjectDetections) -> ObjectDetections:
        positions = np.concatenate([rng.uniform(-50, 50, (5000, 2)), np.zeros((5000, 1))], axis=1)
        return replaced(detections, positions, ["tree"] * 5000) if i in (40, 41) else detections

    counters = mapped(altered_scans(entries, crowd), output)
    assert counters["objects_used"] >= 10_000
    assert counters["detections_used"] == 80


def test_detections_at_the_origin_of_the_body(entries, output):
    counters = mapped(altered_scans(entries, lambda i, d: replaced(d, [[0, 0, 0]], ["tree"])), output)
    assert counters["detections_used"] + counters["detections_repeated"] == 80  # though the body moves


def test_two_objects_at_the_very_same_place_are_two(entries, output):
    """A sign and the lamp post that it hangs on; the body stands."""
    start = next(record for _, _, record in entries if isinstance(record, Odometry))
    still = change(entries, Odometry, lambda i, record: replace(record, T_odom_body=start.T_odom_body))
    place = [[8.0, 3.0, 0.0]] * 2
    mapped(altered_scans(still, lambda i, d: replaced(d, place, ["sign", "lamp"])), output)
    (object_map,) = records_of(output, "/slam/map")
    confirmed = [
        label for label, state in zip(object_map.labels, object_map.states, strict=True) if state == "confirmed"
    ]
    assert sorted(confirmed) == ["lamp", "sign"]


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_positions_that_are_no_places_are_left_out(entries, output, value):
    def spoil(i: int, detections: ObjectDetections) -> ObjectDetections:
        positions = detections.positions.copy()
        positions[0, 0] = value
        return replace(detections, positions=positions)

    counters = mapped(altered_scans(entries, spoil), output)
    assert counters["detections_used"] == 80
    assert counters.get("dropped_objects", 0) + counters["objects_filtered"] == 80


def test_covariances_that_are_none_are_replaced(entries, output):
    def spoil(i: int, detections: ObjectDetections) -> ObjectDetections:
        return replace(detections, covariances=-detections.covariances)

    counters = mapped(altered_scans(entries, spoil), output)
    assert counters["ignored_covariances"] >= 80
    assert counters["landmarks_confirmed"] > 10


@pytest.mark.parametrize("sigma_m", [1e-9, 1e9])
def test_covariances_that_are_absurd_do_not_break_the_solver(entries, output, sigma_m):
    def claim(i: int, detections: ObjectDetections) -> ObjectDetections:
        return replace(detections, covariances=np.tile(sigma_m**2 * np.eye(3), (len(detections.labels), 1, 1)))

    source = write_log(output.with_name("in.mcap"), altered_scans(entries, claim))
    summary = replay_or_refuse(source, output)
    assert isinstance(summary, ReplaySummary)
    assert summary.counters["detections_used"] == sum(isinstance(record, ObjectDetections) for _, _, record in entries)


# The output


def test_a_folder_that_is_not_there_is_told(noisy_log, tmp_path):
    with pytest.raises(UnwritableLogError, match="check that the folder exists"):
        replay(noisy_log, tmp_path / "nowhere" / "out.mcap", Config())


def test_a_folder_is_no_output(noisy_log, tmp_path):
    with pytest.raises(UnwritableLogError, match="is a folder"):
        replay(noisy_log, tmp_path, Config())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_is_told_and_leaves_no_output(noisy_log, output):
    output.with_name("out.mcap.part").symlink_to("/dev/full")
    with pytest.raises(UnwritableLogError, match="No space left on device"):
        replay(noisy_log, output, Config())
    assert not output.exists()


def test_a_disk_that_fills_up_on_the_way_is_told_and_leaves_no_output(noisy_log, output, monkeypatch):
    """The limit on the size of a file stands for the end of the disk."""
    resource = pytest.importorskip("resource", reason="this system has no limits on the size of files")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(UnwritableLogError, match="cannot write"):
            replay(noisy_log, output, Config())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not output.exists()
    assert output.with_name("out.mcap.part").stat().st_size <= 100_000
