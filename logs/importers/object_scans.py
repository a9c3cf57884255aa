"""Object centroids of each scan of a sequence, as GOSMatch publishes them: an archive or a folder of text files."""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import re
import tarfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any
from zlib import error as ZlibError  # noqa: N812 - a class, whatever zlib calls it

import numpy as np

from logs.errors import DatasetError
from logs.importers.text_files import LONGEST_NUMBER, TextFile, parse_numbers, sha256_of
from logs.messages import FloatArray
from logs.storage.regular_file import MOST_BYTES, most_unpacked, open_regular, read_regular

LABELS = ("vehicle", "trunk", "pole")
"""The classes in the order in which ``bow.txt`` counts them."""

_WANTED = re.compile(r"(?:^|/)(?:bow\.txt|centroids/[0-9]{1,18}\.txt)$")

_OPENERS: Mapping[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}


@dataclass(frozen=True, slots=True, eq=False)
class ObjectScans:
    """Objects of each scan: ``positions[i]`` (N_i, 3) metres, velodyne frame, and ``labels[i]`` (N_i,).

    ``sequence`` is the name of the folder; ``sha256`` is over ``bow.txt`` and then the centroids in the order of scans,
    so that an archive and the folder packed into it have the same.
    """

    sequence: str
    positions: tuple[FloatArray, ...]
    labels: tuple[tuple[str, ...], ...]
    sha256: str


def read_object_scans(path: Path, *, sequence: str | None = None) -> ObjectScans:
    """Read ``bow.txt`` and ``centroids/NNNNNN.txt`` from an archive (.tar, .tar.gz, .tar.xz) or a folder.

    The sequence is the folder that has ``bow.txt``, wherever it lies; where several have one, ``sequence`` names it.
    Nothing is extracted to disk: members are read in memory, and what is not a plain file is passed over.

    Raises:
        DatasetError: nothing readable there, no or several sequences, a scan without its file, counts that disagree, or
            a line that is no three numbers; names the file and the line.
    """
    files = _read_folder(path) if path.is_dir() else _read_archive(path)
    folder = _sequence_folder(path, files, sequence)
    name = folder.name or (path.resolve().name if path.is_dir() else ".")
    bow = files[str(folder / "bow.txt")]
    counts = [(number, _class_counts(bow.name, number, line)) for number, line in bow.lines()]
    scans = _scan_files(path, files, folder, len(counts))
    positions, labels = [], []
    for index, ((number, count), file) in enumerate(zip(counts, scans, strict=True)):
        points = [parse_numbers(file.name, i, line.split(), 3) for i, line in file.lines()]
        if len(points) != sum(count):
            raise DatasetError(
                f"scan {index}: {file.name} has {len(points)} centroids, but {bow.name}, line {number} counts "
                f"{sum(count)} ({', '.join(f'{n} {label}' for n, label in zip(count, LABELS, strict=True))})"
            )
        positions.append(np.asarray(points, dtype=np.float64).reshape(-1, 3))
        labels.append(tuple(label for label, n in zip(LABELS, count, strict=True) for _ in range(n)))
    return ObjectScans(name, tuple(positions), tuple(labels), sha256_of([bow, *scans]))


def _read_folder(path: Path) -> dict[str, TextFile]:
    files = {}
    for file in sorted(path.rglob("*.txt")):
        relative = file.relative_to(path).as_posix()
        if _WANTED.search(relative) and file.is_file():
            try:
                files[relative] = TextFile(f"{path.name}/{relative}", read_regular(file))
            except OSError as error:
                raise DatasetError(f"{file}: cannot be read ({error.strerror})") from error
    return files


def _read_archive(path: Path) -> dict[str, TextFile]:
    files = {}
    held = 0
    try:
        with tarfile.open(fileobj=BytesIO(_unpacked(path)), tarinfo=_Member) as archive:
            for member in archive:
                relative = PurePosixPath(member.name).as_posix()
                if not member.isfile() or not _WANTED.search(relative):
                    continue
                held += member.size  # of a sparse file more than the archive holds
                if held > MOST_BYTES:
                    raise tarfile.TarError(f"{held} bytes in its files")
                content = archive.extractfile(member)
                if content is not None:
                    files[relative] = TextFile(f"{path.name}:{relative}", content.read())
    except (OSError, EOFError, ValueError, OverflowError, tarfile.TarError, lzma.LZMAError, ZlibError) as error:
        raise DatasetError(
            f"{path}: cannot be read as an archive ({error}); expected a .tar.xz or .tar.gz, or a folder"
        ) from error
    return files


def _unpacked(path: Path) -> bytes:
    """The archive without its compression: the library would unpack a header of any size into memory."""
    with open_regular(path) as packed:
        magic = packed.read(max(map(len, _OPENERS)))
        packed.seek(0)
        limit = most_unpacked(os.fstat(packed.fileno()).st_size)
        opener = next((each for start, each in _OPENERS.items() if magic.startswith(start)), None)
        content: bytes = packed.read() if opener is None else opener(packed).read(limit + 1)
    if opener is not None and len(content) > limit:
        raise DatasetError(f"{path}: unpacks to more than {limit / 1e6:.0f} MB; unpack it and give the folder")
    return content


class _Member(tarfile.TarInfo):
    """A member of an archive, whose size is not below zero: the library would read it again without end."""

    def _block(self, count: int) -> int:
        if count < 0:
            raise tarfile.HeaderError(f"a member of {count} bytes")
        return int(super()._block(count))  # type: ignore[misc]


def _sequence_folder(path: Path, files: dict[str, TextFile], sequence: str | None) -> PurePosixPath:
    folders = sorted(PurePosixPath(name).parent for name in files if PurePosixPath(name).name == "bow.txt")
    if not folders:
        raise DatasetError(f"{path}: no bow.txt in it; expected <sequence>/bow.txt and <sequence>/centroids/NNNNNN.txt")
    if sequence is not None:
        folders = [folder for folder in folders if folder.name == sequence]
    if len(folders) != 1:
        wanted = "" if sequence is None else f" named {sequence!r}"
        raise DatasetError(
            f"{path}: {len(folders)} sequences{wanted} where one is needed ({', '.join(map(str, folders)) or 'none'}); "
            "name the sequence"
        )
    return folders[0]


def _class_counts(name: str, number: int, line: str) -> tuple[int, int, int]:
    fields = [field.strip() for field in line.split(",")]
    if len(fields) != len(LABELS) or not all(field.isdecimal() and len(field) <= LONGEST_NUMBER for field in fields):
        raise DatasetError(
            f"{name}, line {number}: {line!r} is not '{','.join(f'{label}s' for label in LABELS)}' counts"
        )
    vehicles, trunks, poles = (int(field) for field in fields)
    return vehicles, trunks, poles


def _scan_files(path: Path, files: dict[str, TextFile], folder: PurePosixPath, scan_count: int) -> list[TextFile]:
    by_scan: dict[int, TextFile] = {}
    for name, file in sorted(files.items()):
        member = PurePosixPath(name)
        if member.parent == folder / "centroids":
            index = int(member.stem)
            if index in by_scan:
                raise DatasetError(f"scan {index}: both {by_scan[index].name} and {file.name} hold it")
            by_scan[index] = file
    missing = [index for index in range(scan_count) if index not in by_scan]
    extra = sorted(index for index in by_scan if index >= scan_count)
    if missing or extra:
        fault = f"scan {missing[0]} has no file" if missing else f"scan {extra[0]} is not counted in bow.txt"
        raise DatasetError(f"{path}: bow.txt counts {scan_count} scans, centroids holds {len(by_scan)}; {fault}")
    return [by_scan[index] for index in range(scan_count)]
