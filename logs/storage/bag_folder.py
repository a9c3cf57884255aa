"""The folder of a rosbag2 recording: which files belong to it."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ValidationError

from logs.errors import UnreadableLogError
from logs.storage.regular_file import open_regular

METADATA_FILE = "metadata.yaml"
_MAX_BYTES = 1_000_000
"""Of a description; a second of time is needed for 100 kB."""


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
