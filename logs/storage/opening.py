"""Opens the files of a log; their format is recognised by their first bytes, not by their name."""

from contextlib import ExitStack
from pathlib import Path

from pydantic import BaseModel

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.storage.mcap_file import McapFile
from logs.storage.mcap_index import MAGIC
from logs.storage.regular_file import open_regular

SQLITE_MAGIC = b"SQLite format 3\x00"
ROS1_MAGIC = b"#ROSBAG V"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_SUFFIXES = (".mcap", ".db3")
METADATA_FILE = "metadata.yaml"
_PREFIX = __name__.removesuffix("logs.storage.opening")
"""Of the names of our packages: "dslam." in a wheel."""


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


def open_file(path: Path, limits: ReadingLimits, until_closed: ExitStack) -> McapFile:
    """Open the file at ``path``, which ``until_closed`` closes.

    Raises:
        UnreadableLogError: it cannot be read, or is not MCAP.
    """
    name = str(path)
    try:
        stream = until_closed.enter_context(open_regular(path))
        magic = stream.read(len(SQLITE_MAGIC))
    except OSError as error:
        raise UnreadableLogError(f"cannot read {name}: {error.strerror}; check the path") from error
    if magic.startswith(MAGIC):
        return McapFile(name, stream, limits)
    if magic == SQLITE_MAGIC:
        raise UnreadableLogError(
            f"{name} is a database of rosbag2; convert it by 'rosbags-convert --src {path.resolve().parent} --dst NEW "
            f"--dst-storage mcap --src-typestore-ref {_PREFIX}logs.decoders.ros2_types:TYPES'"
        )
    if magic.startswith(ZSTD_MAGIC):
        raise UnreadableLogError(f"{name} is compressed as a whole; unpack it by 'zstd -d' or 'rosbags-convert'")
    if magic.startswith(ROS1_MAGIC):
        raise UnreadableLogError(
            f"{name} is a bag of ROS 1; convert it by 'rosbags-convert --src {name} --dst FOLDER --dst-storage mcap'"
        )
    if path.name == METADATA_FILE:
        raise UnreadableLogError(f"{name} describes a rosbag2 recording; give the folder that it is in")
    what = "is not an MCAP file (it does not begin with the MCAP signature)" if magic else "is empty"
    raise UnreadableLogError(
        f"{name} {what}; give a log that was recorded as MCAP, or the folder of a rosbag2 recording. "
        "Text files and point clouds become a log by 'dslam import'"
    )


class _Information(BaseModel):
    relative_file_paths: list[str]
    compression_mode: str = ""


class _Metadata(BaseModel):
    rosbag2_bagfile_information: _Information


def find_bag_files(folder: Path) -> list[Path]:
    """The files with messages of the recording in ``folder``, in the order in which they were recorded.

    Raises:
        UnreadableLogError: no usable metadata.yaml, or it names a file that is not there, or compressed ones.
    """
    about = _read_information(folder / METADATA_FILE)
    mode = about.compression_mode.lower()
    if mode in ("file", "message"):
        raise UnreadableLogError(
            f"{folder} is compressed by {mode}; unpack it by 'rosbags-convert --src {folder} "
            "--dst NEW --dst-storage mcap', whose chunks are compressed"
        )
    # The oldest recordings name the files relative to the folder above.
    paths = [
        folder / name if (folder / name).is_file() else folder / Path(name).name for name in about.relative_file_paths
    ]
    missing = [path.name for path in paths if not path.is_file()]
    if missing or not paths:
        raise UnreadableLogError(
            f"{folder / METADATA_FILE} names {', '.join(missing) or 'files'}, which are not there; copy the missing "
            "files, or run 'ros2 bag reindex' to continue without them"
        )
    return paths


def _read_information(path: Path) -> _Information:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        with open_regular(path) as stream:
            # Of 100 kB it takes a second.
            content = YAML(typ="base", pure=True).load(stream.read(1_000_000))
        return _Metadata.model_validate(content).rosbag2_bagfile_information
    except OSError as error:
        raise UnreadableLogError(
            f"cannot read {path}: {error.strerror}; give a log, or the folder of a rosbag2 recording"
        ) from error
    except (YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise UnreadableLogError(
            f"{path} is not the metadata of a rosbag2 recording ({' '.join(str(error).split())[:200]}); "
            "'ros2 bag reindex' writes it anew"
        ) from error
