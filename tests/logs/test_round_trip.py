import dataclasses

import numpy as np

from logs import messages as m
from logs.reader import LogReader
from logs.selection import Selection, select_all
from logs.writer import LogWriter
from tests.helpers.short_drives import write_log, write_records
from tests.logs.examples import assert_same_record, every_kind, random_detections


def read(path, selection=None):
    with LogReader(path) as reader:
        entries = list(reader.records(select_all(reader.topics()) if selection is None else selection))
        assert reader.counters == {}
    return entries


def test_every_kind_of_record_comes_back(tmp_path):
    examples = every_kind(np.random.default_rng(1))
    write_records(tmp_path / "log.mcap", [(topic, record) for topic, _, record in examples])
    selection = Selection.of({topic: kind for topic, kind, _ in examples})
    for entry, (topic, _, record) in zip(read(tmp_path / "log.mcap", selection), examples, strict=True):
        assert (entry.topic, entry.log_time_ns) == (topic, record.stamp_ns)
        assert_same_record(entry.record, record)
    with LogReader(tmp_path / "log.mcap") as reader:
        assert select_all(reader.topics()) == selection


def test_empty_records_come_back(tmp_path):
    records = [random_detections(np.random.default_rng(4), 0, full=False, stamp_ns=5)]
    for _, kind, record in every_kind(np.random.default_rng(4)):
        if kind in ("object_map", "trajectory"):
            values = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
            records.append(dataclasses.replace(record, **{
                name: value[:0] for name, value in values.items() if isinstance(value, np.ndarray | tuple)
            }))  # fmt: skip
    records[1] = dataclasses.replace(records[1], class_probabilities=np.zeros((0, 0)))
    write_records(tmp_path / "log.mcap", [(f"/{i}", record) for i, record in enumerate(records)])
    for entry, expected in zip(read(tmp_path / "log.mcap"), records, strict=True):
        assert_same_record(entry.record, expected, tolerance=0.0)


def test_scene_markers_can_be_read_as_detections(tmp_path):
    markers = m.SceneMarkers(
        stamp_ns=9,
        frame_id="map",
        positions=np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        vocabulary=("pole", "tree"),
        classes=np.array([1, 0]),
        ids=("L1", "L2"),
    )
    write_records(tmp_path / "log.mcap", [("/slam/landmarks", markers)])
    (entry,) = read(tmp_path / "log.mcap")
    assert entry.record.labels == ("tree", "pole")
    assert (entry.record.frame_id, entry.record.stamp_ns) == ("map", 9)
    np.testing.assert_array_equal(entry.record.positions, markers.positions)


def test_records_come_in_the_order_of_log_time_across_chunks(tmp_path):
    rng = np.random.default_rng(7)
    times = rng.permutation(6000)
    written = (("/odom", time_ns, m.Odometry(1_000_000 + time_ns, np.eye(4))) for time_ns in times.tolist())
    write_log(tmp_path / "log.mcap", written)
    with LogReader(tmp_path / "log.mcap") as reader:
        assert len(reader._open[0].blocks) > 1  # type: ignore[attr-defined]
        entries = list(reader.records(Selection.of({"/odom": "odometry"})))
    assert [entry.log_time_ns for entry in entries] == list(range(6000))
    assert [entry.record.stamp_ns for entry in entries] == list(range(1_000_000, 1_006_000))


def test_one_pass_decodes_and_copies(tmp_path):
    write_records(tmp_path / "in.mcap", [(topic, record) for topic, _, record in every_kind(np.random.default_rng(8))])
    copied = {"/ground_truth", "/odom"}
    with LogReader(tmp_path / "in.mcap") as reader, LogWriter(tmp_path / "out.mcap") as writer:
        seen = []
        for item in reader.items(Selection.of({"/odom": "odometry", "/detections": "detections"}), copy=copied):
            seen.append((item.raw.topic, len(item.records)))
            if item.raw.topic in copied:
                writer.write_raw(item.raw)
    assert seen == [("/odom", 1)] * 2 + [("/detections", 1)] * 2 + [("/ground_truth", 0)]
    with LogReader(tmp_path / "in.mcap") as before, LogReader(tmp_path / "out.mcap") as after:
        for a, b in zip(before.messages(copied), after.messages(), strict=True):
            assert (a.topic, a.log_time_ns, a.data) == (b.topic, b.log_time_ns, b.data)
            assert a.channel.schema.data == b.channel.schema.data


def test_topics_tell_counts_times_and_kinds(tmp_path):
    entries = [("/odom", None, m.Odometry(i + 1, np.eye(4))) for i in range(5000)]
    write_log(tmp_path / "log.mcap", [*entries, ("/late", 123, m.Odometry(9, np.eye(4)))])
    with LogReader(tmp_path / "log.mcap") as reader:
        late, odom = reader.topics()
    assert (late.topic, late.message_count, late.first_log_time_ns) == ("/late", 1, 123)  # of its chunk
    assert (odom.message_count, odom.first_log_time_ns, odom.last_log_time_ns) == (5000, 1, 5000)
    assert odom.schema_name == "foxglove.Odometry"
    assert "odometry" in odom.kinds
    assert "ground_truth" in odom.kinds
