"""Foreign text files; faults are reported with their file and line."""

from __future__ import annotations

import gzip
import hashlib
import math
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from logs.errors import DatasetError
from logs.messages import FloatArray
from logs.storage.regular_file import max_unpacked_bytes, read_regular

MAX_DIGITS = 18
"""Of a whole number, so that 64 bits hold it."""
_GZIP, _PARQUET = b"\x1f\x8b", b"PAR1"


@dataclass(frozen=True, slots=True)
class SourceText:
    """A text file in memory; ``name`` is what messages call it, ``sha256`` that of the file as it is, packed or not."""

    name: str
    text: str
    sha256: str

    def lines(self) -> list[tuple[int, str]]:
        """Number (from 1) and text of each line that is neither blank nor a comment (#)."""
        stripped = ((i, line.strip()) for i, line in enumerate(self.text.splitlines(), start=1))
        return [(i, line) for i, line in stripped if line and not line.startswith("#")]

    def numbers(self, count: int) -> tuple[list[int], FloatArray]:
        """The number of each line, and its ``count`` numbers: (R,) and (R, ``count``).

        Raises:
            DatasetError: a line holds another count, or what is no finite number.
        """
        rows = [(line, parse_numbers(self.name, line, text.split(), count)) for line, text in self.lines()]
        values = np.array([row for _, row in rows], dtype=np.float64).reshape(-1, count)
        return [line for line, _ in rows], values


def read_source_text(path: Path) -> SourceText:
    """The file at ``path`` as text; see :func:`source_text`.

    Raises:
        DatasetError: it is missing, cannot be read or unpacked, or is no UTF-8 text.
    """
    try:
        return source_text(str(path), read_regular(path))
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); give the path of the dataset's file") from error


def source_text(name: str, content: bytes) -> SourceText:
    """The content of a file as text: unpacked if it is gzip, as CSV if it is a table in Parquet's format.

    Raises:
        DatasetError: it cannot be unpacked, or is no UTF-8 text.
    """
    plain = _unpacked(name, content) if content.startswith(_GZIP) else content
    if plain.startswith(_PARQUET):
        plain = _parquet_as_csv(name, plain)
    try:
        return SourceText(name, plain.decode("utf-8-sig"), hashlib.sha256(content).hexdigest())
    except UnicodeDecodeError as error:
        raise DatasetError(
            f"{name}: not a text file in UTF-8 (byte {error.start}); save it as UTF-8, or give CSV, JSON lines or poses"
        ) from error


def _unpacked(name: str, packed: bytes) -> bytes:
    limit = max_unpacked_bytes(len(packed))
    try:
        with gzip.open(BytesIO(packed)) as stream:
            content = stream.read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise DatasetError(f"{name}: cannot be unpacked ({error}); copy or pack it again") from error
    if len(content) > limit:
        raise _too_large(name, len(packed), limit)
    return content


def _parquet_as_csv(name: str, content: bytes) -> bytes:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise DatasetError(f"{name}: tables in Parquet's format need pyarrow: pip install pyarrow") from error
    limit = max_unpacked_bytes(len(content))
    try:
        table = parquet.ParquetFile(BytesIO(content))
        about = table.metadata
        packed = sum(about.row_group(group).total_byte_size for group in range(about.num_row_groups))
        if max(packed, about.num_rows * about.num_columns) > limit:
            raise _too_large(name, len(content), limit)
        return bytes(table.read().to_pandas(ignore_metadata=True).to_csv(index=False).encode())
    except (ArrowException, OSError, ValueError) as error:
        raise DatasetError(f"{name}: cannot be read as Parquet ({error}); write it again, or as CSV") from error


def _too_large(name: str, packed: int, limit: int) -> DatasetError:
    return DatasetError(
        f"{name}: its {packed} bytes unpack to more than {limit / 1e6:.0f} MB, more than a table or path; "
        "unpack it and give the file itself"
    )


def parse_numbers(name: str, line: int, fields: Sequence[str], count: int) -> list[float]:
    """``count`` finite numbers.

    Raises:
        DatasetError: another count, or a field that is no finite number; names the file and the line.
    """
    if len(fields) != count:
        raise DatasetError(f"{name}, line {line}: {len(fields)} values where {count} are expected")
    wrong = next((field for field in fields if not is_number(field)), None)
    if wrong is not None:
        raise DatasetError(f"{name}, line {line}: {wrong!r} is not a finite number")
    return [float(field) for field in fields]


def is_number(text: str) -> bool:
    """Whether ``text`` is a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def describe_sources(dataset: str, sources: Iterable[tuple[str, SourceText]]) -> dict[str, str]:
    """What the metadata of an imported log say of its files: by role the name, without folders, and the SHA-256."""
    described = {"dataset": dataset}
    for role, source in sources:
        described |= {role: Path(source.name).name, f"{role}_sha256": source.sha256}
    return described
