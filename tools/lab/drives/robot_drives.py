"""The drives in a folder: one a subfolder, as text files."""

from collections.abc import Sequence
from pathlib import Path

from logs.importers.imported_log import write_drive
from logs.importers.text_log import read_text_log
from slam.common.errors import InputDataError


def find_drives(folder: Path, names: Sequence[str] = ()) -> dict[str, Path]:
    """The folders of all drives at any depth below ``folder``, by name: wherever there is a file ``odometry.*``.

    Args:
        folder: where to look.
        names: take these only, each a drive or a folder of drives.

    Raises:
        InputDataError: the folder holds no drive, or none of a given name.
    """
    found = {path.parent for path in folder.glob("**/odometry.*") if path.is_file()}
    drives = dict(
        sorted((each.relative_to(folder).as_posix() if each != folder else each.resolve().name, each) for each in found)
    )
    if not drives:
        raise InputDataError(
            f"{folder} holds no drives; expected folders with odometry.tum(.gz), detections.csv(.gz) and, for the "
            "errors, groundtruth.tum(.gz)"
        )
    wanted = set()
    for name in names:
        of_name = {each for each in drives if f"{each}/".startswith(f"{name}/")}
        if not of_name:
            raise InputDataError(f"{folder} holds no drive {name!r}; it holds {', '.join(drives)}")
        wanted |= of_name
    return {name: each for name, each in drives.items() if name in wanted or not names}


def import_drive(folder: Path, log: Path) -> None:
    """Write the drive in a folder as a log.

    Raises:
        LogError: a file that cannot be read, or the log cannot be written.
        InputDataError: there are no detections.
    """
    odometry, detections, truth = (
        min((path for path in folder.glob(pattern) if path.is_file()), default=None)
        for pattern in ("odometry.*", "detections.*", "ground*truth.*")
    )
    if odometry is None or detections is None:
        raise InputDataError(f"{folder}: no file odometry.* or detections.*, so there is nothing to map")
    text = read_text_log(odometry=odometry, detections=detections, ground_truth=truth)
    write_drive(log, text.records(), text.source)
