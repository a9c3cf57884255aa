"""Pipes, devices, sockets and files that unpack to anything: no reader waits for them or fills memory or disk."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from logs.digest import file_sha256
from logs.errors import DatasetError, LogError
from logs.importers.maps.object_table import read_object_table
from logs.importers.text_files import read_source_text
from logs.reader import LogReader
from logs.storage import regular_file
from logs.storage.regular_file import open_regular, read_regular
from slam.common.config import load_config
from slam.common.errors import SlamError

READERS: dict[str, Callable[[Path], object]] = {
    "log": LogReader,
    "digest": file_sha256,
    "table": read_source_text,
    "settings": load_config,
    "objects": read_object_table,
}


@pytest.fixture(params=["pipe", "socket", "zeros"])
def endless(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "endless"
    if request.param == "pipe":
        os.mkfifo(path)
    elif request.param == "socket":
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(path))
    else:
        path.symlink_to("/dev/zero")
    return path


@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_of_a_disk_is_refused_by_every_reader(reader: str, endless: Path) -> None:
    with pytest.raises((LogError, SlamError, OSError), match=r"a pipe, a device or a socket|No such device"):
        READERS[reader](endless)


def test_a_name_with_a_zero_byte_is_no_file() -> None:
    with pytest.raises(OSError, match="null byte"):
        open_regular("a\0b")


def test_a_file_that_is_read_as_a_whole_may_not_be_larger_than_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "large.csv"
    with path.open("wb") as stream:
        stream.truncate(regular_file.MAX_BYTES + 1)  # of no blocks
    with pytest.raises(OSError, match="larger than 1000 MB"):
        read_regular(path)
    with pytest.raises(DatasetError, match=r"large\.csv: cannot be read \(larger than 1000 MB\)"):
        read_source_text(path)
    path.write_bytes(b"1,2\n")
    assert read_regular(path) == b"1,2\n"
