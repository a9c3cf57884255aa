"""Recordings of rosbag2: folders, several files, and those that are converted before."""

import re
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from logs.errors import UnreadableLogError
from logs.reader import LogReader
from logs.selection import select_topics
from tests.helpers.ros2_logs import Message, ros2_messages, write_bag
from tests.helpers.short_drives import drive, keep_until, raw_messages
from tests.tools.runs import ROOT


@pytest.fixture(scope="module")
def messages() -> list[Message]:
    return ros2_messages(keep_until(drive(), 12.0))


@pytest.fixture(scope="module")
def bags(messages: list[Message], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    return {"mcap": write_bag(folder / "mcap", messages), "split": write_bag(folder / "split", messages, files=2)}


@pytest.fixture
def bag(bags: dict[str, Path], tmp_path: Path) -> Path:
    """A copy of that of two files."""
    return Path(shutil.copytree(bags["split"], tmp_path / "bag"))


def contents(path: Path) -> list[tuple[str, int, bytes]]:
    return [(raw.topic, raw.log_time_ns, raw.data) for raw in raw_messages(path)]


def test_files_of_a_bag_are_read_as_one(bags: dict[str, Path]) -> None:
    assert contents(bags["split"]) == contents(bags["mcap"])
    with LogReader(bags["split"]) as reader, LogReader(bags["mcap"]) as plain:
        assert reader.topics() == plain.topics()
        assert reader.counters == {}


@pytest.mark.slow
def test_databases_are_refused_with_the_command_that_converts_them(messages: list[Message], tmp_path: Path) -> None:
    """As before ROS 2 Iron, without the definitions of messages."""
    bag = write_bag(tmp_path / "bag", messages, storage="sqlite3")
    with sqlite3.connect(bag / "part_0.db3") as database:
        database.executescript("DROP TABLE message_definitions; DROP TABLE schema")
    described = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(described.replace("version: 8", "version: 4"))
    with pytest.raises(UnreadableLogError, match=r"part_0\.db3 is a database of rosbag2; convert it by") as refused:
        LogReader(bag)
    command = re.search("'rosbags-convert (.*)'", str(refused.value))[1].replace("NEW", str(tmp_path / "new")).split()
    convert = Path(sys.executable).with_name("rosbags-convert")
    subprocess.run([convert, *command], cwd=ROOT, env={"PYTHONPATH": str(ROOT)}, check=True)
    assert contents(tmp_path / "new") == contents(write_bag(tmp_path / "mcap", messages))
    with LogReader(tmp_path / "new") as reader:
        assert len(list(reader.records(select_topics(reader.topics())))) == len(messages)


def test_a_missing_file_is_named(bag: Path) -> None:
    (bag / "part_1.mcap").unlink()
    with pytest.raises(UnreadableLogError, match=r"metadata\.yaml names part_1\.mcap, which are not there; copy"):
        LogReader(bag)


def test_folder_without_metadata_and_metadata_alone_are_refused(bags: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(UnreadableLogError, match=r"metadata\.yaml: No such file .*the folder of a rosbag2 recording"):
        LogReader(tmp_path)
    with pytest.raises(UnreadableLogError, match=r"metadata\.yaml describes a rosbag2 recording; give the folder"):
        LogReader(bags["mcap"] / "metadata.yaml")


@pytest.mark.parametrize("text", ["a: [1", "a: 3", "a: !!int ''", 'a: "\\Uffffffff"', "a: " + "[" * 3000])
def test_metadata_that_is_none(bag: Path, text: str) -> None:
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(
        UnreadableLogError, match=r"metadata\.yaml is not the metadata of a rosbag2 recording"
    ) as caught:
        LogReader(bag)
    assert "\n" not in str(caught.value)


def test_of_a_file_that_ends_early_the_rest_is_read(bags: dict[str, Path], bag: Path) -> None:
    path = bag / "part_1.mcap"
    path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
    with LogReader(bag) as reader:
        assert 0 < len(list(reader.messages())) < len(contents(bags["mcap"]))
        assert reader.counters["truncated"] == 1


def test_chunks_without_a_wanted_topic_are_not_decompressed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from logs.storage import mcap_index

    picture = {"height": 1, "width": 500_000, "step": 500_000, "encoding": "rgb8", "data": np.zeros(500_000)}
    messages: list[Message] = []
    for i in range(30):
        if i % 10 == 0:
            messages.append(("/odom", "nav_msgs/msg/Odometry", i, {}))
        messages.append(("/image", "sensor_msgs/msg/Image", i, picture))
    bag = write_bag(tmp_path / "bag", messages)
    loaded = []
    inner = mcap_index.read_block

    def read_block(stream, block, max_bytes):
        loaded.append(block.chunk_start_offset)
        return inner(stream, block, max_bytes)

    monkeypatch.setattr(mcap_index, "read_block", read_block)
    with LogReader(bag) as reader:
        assert len(list(reader.messages({"/odom"}))) == 3
        assert len(set(loaded)) == 3
        assert len(list(reader.messages())) == 33
        assert len(set(loaded)) == 10


def test_bag_of_ros1_is_refused_with_the_way_to_convert_it(tmp_path: Path) -> None:
    (tmp_path / "drive.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with pytest.raises(UnreadableLogError, match=r"drive\.bag is a bag of ROS 1; convert it by 'rosbags-convert --src"):
        LogReader(tmp_path / "drive.bag")


@pytest.mark.parametrize("compression", ["file", "message"])
def test_compressed_recordings_are_refused_with_the_way_to_unpack_them(
    messages: list[Message], tmp_path: Path, compression: str
) -> None:
    bag = write_bag(tmp_path / "bag", messages[:10], compression=compression)
    with pytest.raises(UnreadableLogError, match=rf"is compressed by {compression}; unpack it by 'rosbags-convert"):
        LogReader(bag)
    if compression == "file":
        with pytest.raises(UnreadableLogError, match="compressed as a whole; unpack it by 'zstd -d'"):
            LogReader(bag / "part_0.mcap.zstd")
