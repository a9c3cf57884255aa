"""Files that are written whole or not at all."""

from pathlib import Path

import pytest

from logs.errors import UnwritableLogError
from logs.storage.placement import replacing, write_text


def test_write_text_replaces_file_and_escapes_surrogates(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    write_text(path, "new \ud800\n")
    assert path.read_bytes() == b"new \\ud800\n"
    assert list(tmp_path.iterdir()) == [path]


def fill_disk(path: Path) -> None:
    with replacing(path) as part:
        part.write_text("half")
        raise OSError(28, "No space left on device")


def test_file_keeps_its_content_where_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(UnwritableLogError, match=r"a\.txt: No space left"):
        fill_disk(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
