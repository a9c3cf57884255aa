"""Arrays attached to a log: mapped into memory, aligned, and checked where that is asked for."""

from pathlib import Path

import numpy as np
import pytest

from logs.errors import UnreadableLogError
from logs.reader import LogReader
from logs.storage.arrays import read_arrays
from logs.writer import LogWriter

ARRAYS: dict[str, np.ndarray] = {
    "positions": np.arange(12, dtype=np.float32).reshape(4, 3),
    "keys": np.array([3, 2**40], dtype=np.int64),
    "names": np.array([b"a", b"tree"]),
    "none": np.zeros((0, 4), dtype=np.uint32),
}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "arrays.mcap"
    with LogWriter(path) as writer:
        writer.add_metadata("about", {"key": "value"})
        for name, array in ARRAYS.items():
            writer.add_array(name, array)
    return path


def test_they_come_back_as_they_were(log: Path) -> None:
    with LogReader(log) as reader:
        assert reader.counters == {}
        assert reader.metadata() == {"about": {"key": "value"}}
    arrays = read_arrays(log, checked=ARRAYS)
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array)
        assert arrays[name].dtype == array.dtype
    mapped = [each for each in arrays.values() if isinstance(each, np.memmap)]
    assert [each.offset % 64 for each in mapped] == [0, 0, 0]  # of a cache line


def test_damage_is_found_where_it_is_looked_for(log: Path) -> None:
    content = bytearray(log.read_bytes())
    content[content.index(ARRAYS["positions"].tobytes()) + 5] ^= 1
    log.write_bytes(content)
    with pytest.raises(UnreadableLogError, match="array positions has another checksum"):
        read_arrays(log, checked=["positions"])
    assert "positions" in read_arrays(log, checked=["keys"])


def test_what_is_cut_off_is_told(log: Path) -> None:
    content = log.read_bytes()
    log.write_bytes(content[: content.index(ARRAYS["keys"].tobytes())])
    with pytest.raises(UnreadableLogError, match="ends early"):
        read_arrays(log)


def test_what_is_no_array_is_told(tmp_path: Path) -> None:
    path = tmp_path / "objects.mcap"
    with LogWriter(path) as writer:
        writer.add_array("positions", np.zeros((4, 3)))
    for text, other in ((b"'<f8'", b"'|O8'"), (b"(4, 3)", b"(9, 9)")):
        (tmp_path / "changed.mcap").write_bytes(path.read_bytes().replace(text, other))
        with pytest.raises(UnreadableLogError, match="cannot be read as an array"):
            read_arrays(tmp_path / "changed.mcap")
