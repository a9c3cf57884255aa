"""Drives mapped live: with a calibration of the robot from an earlier drive, and without any."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from logs.reader import LogReader
from logs.selection import select_all
from logs.topics import RecordKind
from logs.writer import LogWriter
from slam.common.config import Config
from slam.prepared_log import calibrate_logs
from slam.sweeps.mapped_drive import DriveTask, MappedDrive, map_drives

SETTLED_SHARE = 0.2
"""Share of the way after which a robot without calibration is to be as good as a calibrated one."""
REPLAYED, LIVE = (
    ("second half, replayed", "replayed"),
    (
        "second half, live, calibrated by the first",
        "live, not calibrated",
    ),
)


def map_live(write: Callable[[Path, Path], object], data: Path, config: Config, scratch: Path) -> list[MappedDrive]:
    """Map a drive in four ways, replays before the live runs that are compared with them.

    The second half, by its own calibration and live by that of the first half; and the whole drive, by its own
    calibration and live without any, with the online poses after the first fifth of the way.

    Args:
        write: writes the log of the drive from a folder of data.
        data: that folder.
        config: of the estimator.
        scratch: an empty folder.

    Raises:
        LogError: the log cannot be read or halved.
    """
    log, first, second = (scratch / f"{part}.mcap" for part in ("whole", "first", "second"))
    write(log, data)
    write_half(log, first, is_second=False)
    write_half(log, second, is_second=True)
    known = config.model_copy(update={"calibration": calibrate_logs([first], config).config.calibration})
    tasks = [
        DriveTask(REPLAYED[0], second, config, scratch),
        DriveTask(LIVE[0], second, known, scratch, online=True),
        DriveTask(REPLAYED[1], log, config, scratch, online_from=SETTLED_SHARE),
        DriveTask(LIVE[1], log, config, scratch, online=True, online_from=SETTLED_SHARE),
    ]
    return list(map_drives(tasks))


def write_half(source: Path, target: Path, *, is_second: bool) -> None:
    """Copy the messages of the first or the second half of a log by time; transforms of the first are in both."""
    with LogReader(source) as reader, LogWriter(target) as writer:
        infos = reader.topics()
        held = set(select_all(infos).topics_of(RecordKind.TRANSFORMS))
        times = [(info.first_log_time_ns, info.last_log_time_ns) for info in infos]
        first = min(begin for begin, _ in times if begin is not None)
        middle_ns = (first + max(end for _, end in times if end is not None)) // 2
        for raw in reader.messages({info.topic for info in infos}):
            is_later = raw.log_time_ns >= middle_ns
            if is_later == is_second or (raw.topic in held and not is_later):
                writer.write_raw(raw)


def compare_with_replays(runs: Sequence[MappedDrive], key: str) -> list[float | None]:
    """A figure of each live run by that of the replay before it; None for replays, and where one is undefined."""
    ratios: list[float | None] = []
    for replayed, live in zip(runs[::2], runs[1::2], strict=True):
        usual, found = replayed.figure(key), live.figure(key)
        ratios += [None, found / usual if found is not None and usual else None]
    return ratios
