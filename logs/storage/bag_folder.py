"""The folder of a rosbag2 recording: which files belong to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from logs.errors import UnreadableLogError
from logs.storage.regular_file import open_regular

METADATA_FILE = "metadata.yaml"
_LIST = "relative_file_paths"
_MAX_BYTES = 1_000_000
"""Of a description; a second of time is needed for 100 kB."""


def find_bag_files(folder: Path) -> list[Path]:
    """The files with messages of the recording in ``folder``, in the order in which they were recorded.

    Raises:
        UnreadableLogError: no usable metadata.yaml, or it names a file that is not there.
    """
    names = _read_file_names(folder)
    # The oldest recordings name the files relative to the folder above.
    paths = [folder / name if (folder / name).is_file() else folder / Path(name).name for name in names]
    missing = [path.name for path in paths if not path.is_file()]
    if missing:
        raise UnreadableLogError(
            f"{folder / METADATA_FILE} names {', '.join(missing)}, which {'is' if len(missing) == 1 else 'are'} not "
            "there; copy the missing files, or run 'ros2 bag reindex' to continue without them"
        )
    return paths


def _read_file_names(folder: Path) -> list[str]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    path = folder / METADATA_FILE
    if not path.is_file():
        bags = sorted(p.parent.name for p in folder.glob(f"*/{METADATA_FILE}"))
        files = bags or sorted(p.name for p in folder.iterdir() if p.name.endswith((".mcap", ".db3", ".zstd")))
        which = "recordings" if bags else "files"
        remedy = f"give one of its {which} ({', '.join(files[:3])}{', ...' if len(files) > 3 else ''})" if files else ""
        remedy = remedy or "give a log, or the directory of a rosbag2 recording"
        raise UnreadableLogError(f"cannot read {folder}: it is a directory without {METADATA_FILE}; {remedy}")
    try:
        with open_regular(path) as stream:
            names = _file_names(YAML(typ="base", pure=True).load(stream.read(_MAX_BYTES)))
    except OSError as error:
        raise UnreadableLogError(f"cannot read {path}: {error.strerror}; check the path") from error
    except (YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise UnreadableLogError(
            f"{path} is not the metadata of a rosbag2 recording ({' '.join(str(error).split())}); "
            "'ros2 bag reindex' writes it anew"
        ) from error
    if not names:
        raise UnreadableLogError(f"{path} names no files: the recording is empty")
    return names


def _file_names(content: Any) -> list[str]:
    """The list ``relative_file_paths``.

    Raises:
        ValueError: there is no such list, or other things than texts are in it.
    """
    information = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    names = information.get(_LIST) if isinstance(information, dict) else None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{_LIST} is not a list of strings")
    return names
