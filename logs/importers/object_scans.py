"""Object centroids of each scan of a sequence, as GOSMatch publishes them: an archive or a folder of text files."""

from __future__ import annotations

import bz2
import gzip
import hashlib
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
from logs.importers.tables import read_table
from logs.importers.text_files import source_text
from logs.messages import FloatArray
from logs.storage.regular_file import MAX_BYTES, max_unpacked_bytes, open_regular, read_regular

LABELS = ("vehicle", "trunk", "pole")
"""The classes in the order in which ``bow.txt`` counts them."""

_WANTED = re.compile(r"(?:^|/)(?:bow\.txt|centroids/[0-9]{1,18}\.txt)$")
_OPENERS: Mapping[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
_DAMAGE = (OSError, EOFError, ValueError, OverflowError, tarfile.TarError, lzma.LZMAError, ZlibError)


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


def read_object_scans(path: Path) -> ObjectScans:
    """Read ``bow.txt`` and ``centroids/NNNNNN.txt`` from an archive (.tar, .tar.gz, .tar.xz) or a folder.

    The sequence is the folder that has ``bow.txt``, wherever it lies.
    Nothing is extracted to disk: members are read in memory, and other members than plain files are ignored.

    Raises:
        DatasetError: nothing readable there, no or several sequences, a scan without its file, counts that disagree, or
            a line that is no three numbers; names the file and the line.
    """
    files = _read_folder(path) if path.is_dir() else _read_archive(path)
    folder = _sequence_folder(path, files)
    separator = "/" if path.is_dir() else ":"
    bow_name = str(folder / "bow.txt")
    bow = source_text(f"{path.name}{separator}{bow_name}", files[bow_name])
    counts = [[int(number) for number in row] for row in read_table(bow, LABELS).matrix().tolist()]
    names = _scan_names(path, files, folder, len(counts))
    positions, labels = [], []
    for count, name in zip(counts, names, strict=True):
        file = source_text(f"{path.name}{separator}{name}", files[name])
        points = read_table(file, "xyz").matrix()
        if min(count) < 0 or len(points) != sum(count):
            raise DatasetError(f"{file.name} has {len(points)} centroids, but {bow.name} counts {count} for this scan")
        positions.append(points)
        labels.append(tuple(np.repeat(LABELS, count).tolist()))
    digest = hashlib.sha256(b"".join(files[name] for name in (bow_name, *names)))
    name = folder.name or (path.resolve().name if path.is_dir() else ".")
    return ObjectScans(name, tuple(positions), tuple(labels), digest.hexdigest())


def _read_folder(path: Path) -> dict[str, bytes]:
    names = {file.relative_to(path).as_posix(): file for file in sorted(path.rglob("*.txt"))}
    try:
        return {name: read_regular(file) for name, file in names.items() if _WANTED.search(name) and file.is_file()}
    except OSError as error:
        raise DatasetError(f"{error.filename}: cannot be read ({error.strerror})") from error


def _read_archive(path: Path) -> dict[str, bytes]:
    files = {}
    held = 0
    try:
        with tarfile.open(fileobj=BytesIO(_unpacked(path)), tarinfo=_Member) as archive:
            for member in archive:
                name = PurePosixPath(member.name).as_posix()
                if not member.isfile() or not _WANTED.search(name):
                    continue
                held += member.size  # of a sparse file more than the archive holds
                if held > MAX_BYTES:
                    raise tarfile.TarError(f"{held} bytes in its files")
                content = archive.extractfile(member)
                if content is not None:
                    files[name] = content.read()
    except _DAMAGE as error:
        raise DatasetError(
            f"{path}: cannot be read as an archive ({error}); expected a .tar.xz or .tar.gz, or a folder"
        ) from error
    return files


def _unpacked(path: Path) -> bytes:
    """The archive without its compression: the library would unpack a header of any size into memory."""
    with open_regular(path) as packed:
        magic = packed.read(max(map(len, _OPENERS)))
        packed.seek(0)
        limit = max_unpacked_bytes(os.fstat(packed.fileno()).st_size)
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


def _sequence_folder(path: Path, files: Mapping[str, bytes]) -> PurePosixPath:
    folders = [PurePosixPath(name).parent for name in files if PurePosixPath(name).name == "bow.txt"]
    if len(folders) != 1:
        raise DatasetError(
            f"{path} holds {len(folders)} files bow.txt where one is needed; expected one sequence, with bow.txt and "
            "centroids/NNNNNN.txt"
        )
    return folders[0]


def _scan_names(path: Path, files: Mapping[str, bytes], folder: PurePosixPath, scan_count: int) -> list[str]:
    """Name of the file of each scan."""
    members = [PurePosixPath(name) for name in sorted(files)]
    numbered = sorted((int(each.stem), str(each)) for each in members if each.parent == folder / "centroids")
    if [number for number, _ in numbered] != list(range(scan_count)):
        raise DatasetError(
            f"{path}: bow.txt counts {scan_count} scans, centroids holds {len(numbered)} files; each scan needs one "
            f"line and one file, numbered from 0 to {scan_count - 1}"
        )
    return [name for _, name in numbered]
