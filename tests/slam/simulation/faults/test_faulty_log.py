from pathlib import Path

import pytest

from logs.messages import Transform
from slam.common.errors import SimulationError
from slam.simulation.faults.faulty_log import write_faulty
from slam.simulation.faults.registry import parse_faults
from tests.helpers.short_drives import metadata_of, raw_messages, write_log, write_records
from tests.slam.simulation.faults.streams import START_NS, T_BODY_SENSOR, drive, messages


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    entries = ((message.topic, message.log_time_ns + 5, message.record) for message in messages())
    return write_log(path, entries, source={"dataset": "made up"})


def test_topics_that_no_fault_changes_keep_their_bytes(log: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    summary = write_faulty(log, output, parse_faults(["heading_jump=30"]), seed=0)
    before, after = ([(raw.topic, raw.log_time_ns, raw.data) for raw in raw_messages(path)] for path in (log, output))
    assert {a[0] for a, b in zip(before, after, strict=True) if a != b} == {"/odom"}
    assert summary.message_counts["/odom"] == sum(topic == "/odom" for topic, *_ in before)
    assert summary.detections == summary.detections_before > 0


def test_same_input_gives_same_bytes_and_another_seed_other_messages(log: Path, tmp_path: Path) -> None:
    first, second, other = (tmp_path / f"{name}.mcap" for name in "abc")
    for output, seed in ((first, 1), (second, 1), (other, 2)):
        write_faulty(log, output, parse_faults(["labels_random", "odometry_jumps"]), seed=seed)
    assert first.read_bytes() == second.read_bytes()
    assert [raw.data for raw in raw_messages(first)] != [raw.data for raw in raw_messages(other)]


def test_what_was_done_stands_in_the_log(log: Path, tmp_path: Path) -> None:
    once, twice = tmp_path / "once.mcap", tmp_path / "twice.mcap"
    write_faulty(log, once, parse_faults(["time_offset", "gyro_bias=30:1"]), seed=4)
    write_faulty(once, twice, parse_faults(["labels_unique"]), seed=5)
    told = metadata_of(twice)
    assert told["source"] == {"dataset": "made up"}
    assert (told["faults"]["faults"], told["faults"]["seed"]) == ("time_offset=0.1 gyro_bias=30:1", "4")
    assert (told["faults_2"]["faults"], told["faults_2"]["seed"]) == ("labels_unique", "5")


def test_a_topic_that_plays_two_parts_is_refused(log: Path, tmp_path: Path) -> None:
    odometry = [("/tf", Transform(START_NS + i, "odom", "base_link", T_BODY_SENSOR)) for i in range(3)]
    frames = write_records(
        tmp_path / "frames.mcap", [*odometry, *(("/detections", scan.seen) for scan in drive().scans)]
    )
    with pytest.raises(SimulationError, match="cannot be rewritten"):
        write_faulty(frames, tmp_path / "out.mcap", parse_faults(["gyro_bias"]), seed=0, topics={"odometry": "/tf"})
