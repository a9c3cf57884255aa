"""Foreign text files; faults are reported with their file and line."""

import gzip
import hashlib
import zlib
from io import BytesIO
from pathlib import Path

from logs.errors import DatasetError
from logs.records import frozen
from logs.storage.regular_file import read_regular


@frozen
class SourceText:
    """A text file in memory; ``name`` is what messages call it, ``sha256`` that of the file as it is, packed or not."""

    name: str
    text: str
    sha256: str

    def lines(self) -> list[tuple[int, str]]:
        """Number (from 1) and text of each line that is neither blank nor a comment (#)."""
        stripped = ((i, line.strip(" ")) for i, line in enumerate(self.text.splitlines(), start=1))
        return [(i, line) for i, line in stripped if line.strip() and not line.startswith("#")]


def read_source_text(path: Path) -> SourceText:
    """The file at ``path`` as text, unpacked if it is gzip.

    Raises:
        DatasetError: it is missing, cannot be read or unpacked, or is no UTF-8 text.
    """
    name = str(path)
    try:
        content = read_regular(path)
    except OSError as error:
        raise DatasetError(f"{name}: cannot be read ({error.strerror}); give the path of the dataset's file") from error
    plain = _unpacked(name, content) if content.startswith(b"\x1f\x8b") else content
    try:
        if b"\0" in plain:
            raise UnicodeDecodeError("utf-8", plain, plain.index(b"\0"), len(plain), "not text")
        return SourceText(name, plain.decode("utf-8-sig"), hashlib.sha256(content).hexdigest())
    except UnicodeDecodeError as error:
        raise DatasetError(
            f"{name}: not a text file in UTF-8 (byte {error.start}); save it as text, for example as CSV"
        ) from error


def _unpacked(name: str, packed: bytes) -> bytes:
    # Tables and paths pack to a tenth or so.
    limit = max(100 * len(packed), 64_000_000)
    try:
        with gzip.open(BytesIO(packed)) as stream:
            content = stream.read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise DatasetError(f"{name}: cannot be unpacked ({error}); copy or pack it again") from error
    if len(content) > limit:
        raise DatasetError(
            f"{name}: its {len(packed)} bytes unpack to more than {limit / 1e6:.0f} MB, more than a table or path; "
            "unpack it and give the file itself"
        )
    return content
