"""The folder of a rosbag2 recording: which files belong to it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

from logs.errors import UnreadableLogError
from logs.storage.regular_file import open_regular

METADATA_FILE = "metadata.yaml"
_LIST = "relative_file_paths"
_MOST_BYTES = 1_000_000
"""Of a description; a second of time is needed for 100 kB."""
_DEEPEST = 32


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
            "there; copy the missing files, or run 'ros2 bag reindex' to go on without them"
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
            names = _file_names(YAML(typ="safe", pure=True).parse(stream.read(_MOST_BYTES)))
    except OSError as error:
        raise UnreadableLogError(f"cannot read {path}: {error.strerror}; check the path") from error
    except (YAMLError, ValueError, OverflowError) as error:
        raise UnreadableLogError(
            f"{path} is not the metadata of a rosbag2 recording ({' '.join(str(error).split())}); "
            "'ros2 bag reindex' writes it anew"
        ) from error
    if not names:
        raise UnreadableLogError(f"{path} names no files: the recording is empty")
    return names


def _file_names(events: Iterator[Any]) -> list[str]:
    """The list ``relative_file_paths``. Nothing else is made of what the file says: YAML may hold anything.

    Raises:
        ValueError: there is no such list, or other things than texts are in it.
    """
    depth, is_near = 0, False
    for event in events:
        kind = type(event).__name__
        if is_near and kind == "SequenceStartEvent":
            return [_text(each) for each in takewhile(lambda each: type(each).__name__ != "SequenceEndEvent", events)]
        is_near = getattr(event, "value", None) == _LIST
        depth += kind.endswith("StartEvent") - kind.endswith("EndEvent")
        if depth > _DEEPEST:
            raise ValueError("nested too deeply")
    raise ValueError(f"no list {_LIST}")


def _text(event: Any) -> str:
    value = getattr(event, "value", None)
    if not isinstance(value, str):
        raise ValueError(f"its {_LIST} are not text")
    return value
