"""Lines of numbers in foreign text files, read so that whatever is wrong is reported with its file and line."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from logs.errors import DatasetError
from logs.storage.regular_file import read_regular

LONGEST_NUMBER = 18
"""Digits of a whole number, so that 64 bits hold it."""


@dataclass(frozen=True, slots=True)
class TextFile:
    """One file of a dataset in memory; ``name`` is what messages call it."""

    name: str
    content: bytes

    def lines(self) -> Iterable[tuple[int, str]]:
        """Number (from 1) and text of each line that is not blank.

        Raises:
            DatasetError: the content is not ASCII text.
        """
        try:
            text = self.content.decode("ascii")
        except UnicodeDecodeError as error:
            raise DatasetError(
                f"{self.name}: not a text file (byte {error.start}); expected lines of numbers"
            ) from error
        for number, line in enumerate(text.splitlines(), start=1):
            if line.strip():
                yield number, line.strip()


def read_text_file(path: Path) -> TextFile:
    """The file at ``path``, called by its path in messages.

    Raises:
        DatasetError: it is missing or cannot be read.
    """
    try:
        return TextFile(str(path), read_regular(path))
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); give the path of the dataset's file") from error


def parse_numbers(name: str, line: int, fields: Iterable[str], count: int) -> list[float]:
    """``count`` finite numbers.

    Raises:
        DatasetError: another count, or a field that is no finite number; names the file and the line.
    """
    texts = list(fields)
    if len(texts) != count:
        raise DatasetError(f"{name}, line {line}: {len(texts)} values where {count} are expected")
    numbers = []
    for text in texts:
        try:
            number = float(text)
        except ValueError as error:
            raise DatasetError(f"{name}, line {line}: {text!r} is not a number") from error
        if not math.isfinite(number):
            raise DatasetError(f"{name}, line {line}: {text!r} is not a finite number")
        numbers.append(number)
    return numbers


def sha256_of(files: Iterable[TextFile]) -> str:
    """SHA-256 over the contents one after the other; of a single file it is what ``sha256sum`` prints."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.content)
    return digest.hexdigest()
