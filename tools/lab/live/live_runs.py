"""Drives mapped live: with a calibration of the robot from an earlier drive, and without any."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from logs.reader import LogReader
from logs.selection import select_all
from logs.topics import RecordKind
from logs.writer import LogWriter
from slam.common.config import Config
from slam.prepared_log import calibrate_logs
from slam.sweeps.mapped_drive import DriveTask, MappedDrive, map_drives

SETTLED_SHARE = 0.2
"""Share of the way after which a robot that nobody calibrated is to be as good as one that was calibrated."""


@dataclass(frozen=True, slots=True)
class LiveRuns:
    """A drive's second half, mapped by its own calibration and live by that of the first half; and the whole drive,
    mapped by its own calibration and live without any.
    """

    name: str
    half: MappedDrive
    calibrated: MappedDrive
    whole: MappedDrive
    uncalibrated: MappedDrive

    @property
    def failures(self) -> list[str]:
        """Why runs have no figures."""
        runs = (self.half, self.calibrated, self.whole, self.uncalibrated)
        return [f"{run.name}: {run.error}" for run in runs if run.error]

    def ratios(self) -> tuple[float | None, float | None, float | None, float | None]:
        """ATE of the final map and online, live by that of a replay: calibrated, and not calibrated after the first
        fifth of the way.
        """
        return (
            _ratio(self.calibrated, self.half, "ate_m"),
            _ratio(self.calibrated, self.half, "online_ate_m"),
            _ratio(self.uncalibrated, self.whole, "ate_m"),
            _ratio(self.uncalibrated, self.whole, "online_ate_m"),
        )


def run_live(name: str, write: Callable[[Path, Path], object], data: Path, config: Config, scratch: Path) -> LiveRuns:
    """Map a drive that ``write`` writes as a log from a folder of ``data``, in each of the four ways, in ``scratch``.

    Raises:
        LogError: the log cannot be read or halved.
    """
    log, first, second = (scratch / f"{part}.mcap" for part in ("whole", "first", "second"))
    write(log, data)
    write_half(log, first, is_second=False)
    write_half(log, second, is_second=True)
    known = config.model_copy(update={"calibration": calibrate_logs([first], config).config.calibration})
    tasks = [
        DriveTask("half", second, config, scratch),
        DriveTask("calibrated", second, known, scratch, online=True),
        DriveTask("whole", log, config, scratch, online_from=SETTLED_SHARE),
        DriveTask("uncalibrated", log, config, scratch, online=True, online_from=SETTLED_SHARE),
    ]
    runs = {run.name: run for run in map_drives(tasks)}
    return LiveRuns(name, **runs)


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


def _ratio(live: MappedDrive, replayed: MappedDrive, figure: str) -> float | None:
    found, usual = (run.figure(f"trajectory.{figure}") for run in (live, replayed))
    return found / usual if found is not None and usual else None


def rows_of(runs: LiveRuns) -> Iterator[tuple[str, MappedDrive]]:
    """The four runs by what a table calls them."""
    yield "second half, replayed", runs.half
    yield "second half, live, calibrated by the first", runs.calibrated
    yield "replayed", runs.whole
    yield "live, not calibrated", runs.uncalibrated
