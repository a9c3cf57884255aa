"""The drives in a folder: one a subfolder, as text files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from logs.importers.imported_log import write_drive
from logs.importers.text_log import read_text_log
from slam.common.errors import InputDataError


@dataclass(frozen=True, slots=True)
class RobotDrive:
    """The files in one folder whose names begin with odometry, detections and groundtruth; ``name`` is that folder."""

    name: str
    odometry: Path
    detections: Path | None
    ground_truth: Path | None


def find_drives(folder: Path, names: Sequence[str] = ()) -> list[RobotDrive]:
    """All drives at any depth below ``folder``, by name: wherever there is a file ``odometry.*``.

    Args:
        folder: where to look.
        names: take these only, each a drive or a folder of drives.

    Raises:
        InputDataError: the folder holds no drive, or none of a given name.
    """
    found = {path.parent for path in folder.glob("**/odometry.*") if path.is_file()}
    drives = sorted((_drive(folder, each) for each in found), key=lambda drive: drive.name)
    if not drives:
        raise InputDataError(
            f"{folder} holds no drives; expected folders with odometry.tum(.gz), detections.csv(.gz) and, for the "
            "errors, groundtruth.tum(.gz)"
        )
    for name in names:
        if not any(_is_in(drive, name) for drive in drives):
            there = ", ".join(drive.name for drive in drives)
            raise InputDataError(f"{folder} holds no drive {name!r}; it holds {there}")
    return [drive for drive in drives if not names or any(_is_in(drive, name) for name in names)]


def import_drive(drive: RobotDrive, log: Path) -> None:
    """Write the drive as a log.

    Raises:
        LogError: a file that cannot be read, or the log cannot be written.
        InputDataError: there are no detections.
    """
    if drive.detections is None:
        raise InputDataError(f"{drive.odometry.parent}: no file detections.*, so there is nothing to map")
    text = read_text_log(odometry=drive.odometry, detections=drive.detections, ground_truth=drive.ground_truth)
    write_drive(log, text.records(), text.source)


def _is_in(drive: RobotDrive, name: str) -> bool:
    return drive.name == name or drive.name.startswith(f"{name}/")


def _drive(root: Path, folder: Path) -> RobotDrive:
    odometry = _first(folder, "odometry.*")
    if odometry is None:
        raise InputDataError(f"{folder}: no file odometry.*")
    name = folder.relative_to(root).as_posix() if folder != root else folder.resolve().name
    truth = _first(folder, "groundtruth.*") or _first(folder, "ground_truth.*")
    return RobotDrive(name, odometry, _first(folder, "detections.*"), truth)


def _first(folder: Path, pattern: str) -> Path | None:
    return min((path for path in folder.glob(pattern) if path.is_file()), default=None)
