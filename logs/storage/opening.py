"""Opens the files of a log; their format is recognised by their first bytes, not by their name."""

from __future__ import annotations

import logging
import os
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import zstandard
from pydantic import BaseModel, ValidationError

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.storage.mcap_file import McapFile
from logs.storage.mcap_index import MAGIC
from logs.storage.regular_file import max_unpacked_bytes, open_regular
from logs.storage.storage import Storage

SQLITE_MAGIC = b"SQLite format 3\x00"
ROS1_MAGIC = b"#ROSBAG V"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_SUFFIXES = (".mcap", ".db3", ".zstd")
_PIECE_BYTES = 2**20
METADATA_FILE = "metadata.yaml"
_MAX_BYTES = 1_000_000
"""Of a description; a second of time is needed for 100 kB."""

_log = logging.getLogger(__name__)


def find_files(path: Path) -> list[Path]:
    """The files of the log at ``path``: the file itself, or those of a rosbag2 folder.

    Raises:
        UnreadableLogError: nothing is there, or a folder is no whole recording.
    """
    if path.is_dir():
        return find_bag_files(path)
    if not path.exists():
        raise UnreadableLogError(f"cannot read {path}: No such file or directory; check the path")
    return [path]


def is_log(path: Path) -> bool:
    """Whether what is at ``path`` is to be read as a log: by its name, else by its first bytes; also if nothing is."""
    if path.is_dir() or path.suffix in _SUFFIXES:
        return True
    try:
        with open_regular(path) as stream:
            magic = stream.read(len(SQLITE_MAGIC))
    except OSError:
        return True
    return not magic or magic.startswith((MAGIC, SQLITE_MAGIC, ROS1_MAGIC, ZSTD_MAGIC))


def open_storage(path: Path, limits: ReadingLimits, until_closed: ExitStack, name: str = "") -> Storage:
    """Open the file at ``path``; one that is compressed as a whole is unpacked into a temporary folder first.

    ``until_closed`` closes it, and removes that folder. ``name``: what messages call it, by default the path.

    Raises:
        UnreadableLogError: it cannot be read, or is neither MCAP nor a database of rosbag2.
    """
    name = name or str(path)
    try:
        with open_regular(path) as stream:
            magic = stream.read(len(SQLITE_MAGIC))
    except OSError as error:
        raise UnreadableLogError(f"cannot read {name}: {error.strerror}; check the path") from error
    if magic.startswith(ZSTD_MAGIC):
        scratch = until_closed.enter_context(TemporaryDirectory(prefix="dslam-"))
        return open_storage(_unpack(path, Path(scratch)), limits, until_closed, name)
    storage: Storage | None = None
    if magic.startswith(MAGIC):
        storage = McapFile(path, name, limits)
    elif magic == SQLITE_MAGIC:
        from logs.storage.sqlite_file import SqliteFile  # loads rosbags

        storage = SqliteFile(path, name, limits)
    if storage is not None:
        until_closed.callback(storage.close)
        return storage
    if magic.startswith(ROS1_MAGIC):
        raise UnreadableLogError(
            f"{name} is a bag of ROS 1; convert it by 'rosbags-convert --src {name} --dst FOLDER --dst-storage mcap'"
        )
    if path.name == METADATA_FILE:
        raise UnreadableLogError(f"{name} describes a rosbag2 recording; give the folder that it is in")
    what = "is not an MCAP file (it does not begin with the MCAP signature)" if magic else "is empty"
    raise UnreadableLogError(
        f"{name} {what}; give a log that was recorded as MCAP, a rosbag2 folder or file (.mcap, .db3, .zstd). "
        "Text files become a log by 'dslam import'"
    )


def _unpack(path: Path, folder: Path) -> Path:
    """The file at ``path``, decompressed; of one that ends early, what there is."""
    unpacked = folder / path.stem
    _log.info("unpacking %s", path)
    try:
        with open_regular(path) as packed, open(unpacked, "wb") as stream:
            limit = max_unpacked_bytes(os.fstat(packed.fileno()).st_size)
            reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            for piece in iter(partial(reader.read, _PIECE_BYTES), b""):
                stream.write(piece)
                if stream.tell() > limit:
                    raise UnreadableLogError(
                        f"{path} unpacks to more than {limit / 1e6:.0f} MB, more than a log; "
                        "unpack it and give the log itself"
                    )
    except zstandard.ZstdError as error:
        if not unpacked.stat().st_size:
            raise UnreadableLogError(f"{path} cannot be decompressed: {error}; copy it again") from error
        _log.warning("%s is damaged: only its first %d bytes can be read (%s)", path, unpacked.stat().st_size, error)
    except OSError as error:
        raise UnreadableLogError(
            f"cannot unpack {path} into {folder}: {error.strerror}; make room there, or set TMPDIR to another folder"
        ) from error
    return unpacked


class _Information(BaseModel):
    relative_file_paths: list[str]


class _Metadata(BaseModel):
    rosbag2_bagfile_information: _Information


def find_bag_files(folder: Path) -> list[Path]:
    """The files with messages of the recording in ``folder``, in the order in which they were recorded.

    Raises:
        UnreadableLogError: no usable metadata.yaml, or it names a file that is not there.
    """
    names = _read_file_names(folder / METADATA_FILE)
    # The oldest recordings name the files relative to the folder above.
    paths = [folder / name if (folder / name).is_file() else folder / Path(name).name for name in names]
    missing = [path.name for path in paths if not path.is_file()]
    if missing or not paths:
        raise UnreadableLogError(
            f"{folder / METADATA_FILE} names {', '.join(missing) or 'files'}, which are not there; copy the missing "
            "files, or run 'ros2 bag reindex' to continue without them"
        )
    return paths


def _read_file_names(path: Path) -> list[str]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        with open_regular(path) as stream:
            content = YAML(typ="base", pure=True).load(stream.read(_MAX_BYTES))
        return _Metadata.model_validate(content).rosbag2_bagfile_information.relative_file_paths
    except OSError as error:
        raise UnreadableLogError(
            f"cannot read {path}: {error.strerror}; give a log, or the folder of a rosbag2 recording"
        ) from error
    except (YAMLError, ValidationError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise UnreadableLogError(
            f"{path} is not the metadata of a rosbag2 recording ({' '.join(str(error).split())[:200]}); "
            "'ros2 bag reindex' writes it anew"
        ) from error
