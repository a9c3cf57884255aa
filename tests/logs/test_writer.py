import os
from io import FileIO

import numpy as np
import pytest

from logs import messages as m
from logs.errors import InvalidRecordError, LogError, UnreadableLogError, UnwritableLogError
from logs.storage.placement import put_in_place
from logs.writer import LogWriter
from tests.helpers.short_drives import records_of


def stamps_in(path):
    return [record.stamp_ns for record in records_of(path, "/odom")]


def test_final_name_appears_only_when_log_is_whole(tmp_path):
    """What a killed run has written until then can be read: all but the last chunk, and after a flush all."""
    path, partial = tmp_path / "log.mcap", tmp_path / "log.mcap.part"
    with LogWriter(path) as writer:
        for i in range(5000):
            writer.write("/odom", m.Odometry(i, np.eye(4)))
            if i == 0:
                writer.flush()
                assert stamps_in(partial) == [0]
        found = stamps_in(partial)
        assert 2500 < len(found) < 5000
        assert found == list(range(len(found)))
        assert not path.exists()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("count", "error", "is_kept"),
    [(1, UnreadableLogError(), False), (1, RuntimeError(), True), (0, RuntimeError(), False)],
)
def test_partial_log_after_an_error(tmp_path, count, error, is_kept):
    def write_and_raise():
        with LogWriter(tmp_path / "log.mcap", refusals=(LogError,)) as writer:
            writer.add_metadata("source", {"a": "1"})
            for i in range(count):
                writer.write("/odom", m.Odometry(i, np.eye(4)))
            raise error

    with pytest.raises(type(error)) as caught:
        write_and_raise()
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap.part"] * is_kept
    assert hasattr(caught.value, "__notes__") == is_kept
    assert not is_kept or len(stamps_in(tmp_path / "log.mcap.part")) == 1


def test_a_pipe_or_a_device_is_not_replaced(tmp_path):
    pipe, part = tmp_path / "log.mcap", tmp_path / "finished"
    os.mkfifo(pipe)
    with pytest.raises(UnwritableLogError, match="a pipe or a socket, which a file would replace"):
        LogWriter(pipe)
    part.touch()
    with pytest.raises(OSError, match="which a file would replace"):
        put_in_place(part, pipe)
    assert pipe.is_fifo()


def test_who_is_stopped_while_a_log_is_begun_is_told_what_is_left(tmp_path, monkeypatch):
    def stopped(self, **_):
        raise KeyboardInterrupt

    monkeypatch.setattr("logs.writer.Writer.start", stopped)
    with pytest.raises(KeyboardInterrupt) as caught:
        LogWriter(tmp_path / "log.mcap")
    assert str(tmp_path / "log.mcap.part") in caught.value.__notes__[0]


def test_a_disk_that_fills_up_is_one_clear_error(tmp_path, monkeypatch):
    class Full(FileIO):
        def write(self, data):
            if self.tell() > 1000:
                raise OSError(28, "No space left on device")
            return super().write(data)

    def write_a_lot():
        with LogWriter(tmp_path / "log.mcap") as writer:
            for i in range(10_000):
                writer.write("/odom", m.Odometry(i + 1, np.eye(4)))

    monkeypatch.setattr("logs.writer.FileIO", Full)
    with pytest.raises(UnwritableLogError, match="No space left"):
        write_a_lot()
    assert not (tmp_path / "log.mcap").exists()
    assert (tmp_path / "log.mcap.part").exists()


def test_a_path_that_cannot_be_written(tmp_path):
    with pytest.raises(UnwritableLogError, match="No such file"):
        LogWriter(tmp_path / "no folder" / "log.mcap")


@pytest.mark.parametrize("time_ns", [-1, 2**62])
def test_a_time_that_no_log_can_hold_is_refused_at_once(tmp_path, time_ns):
    with LogWriter(tmp_path / "log.mcap") as writer:
        with pytest.raises(InvalidRecordError, match=rf"/odom.*{time_ns} ns"):
            writer.write("/odom", m.Odometry(0, np.eye(4)), time_ns)
        writer.write("/odom", m.Odometry(1, np.eye(4)))
    assert stamps_in(tmp_path / "log.mcap") == [1]
