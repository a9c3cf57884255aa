"""Faults of stamps, rates and gaps. Each public function is a fault."""

from itertools import compress
from typing import Annotated

import numpy as np
from pydantic import Field

from slam.simulation.faults.parameters import Duration, Hertz, Part, Seconds
from slam.simulation.faults.recording import Recording, Scan, seconds_ns

_Ppm = Annotated[float, Field(ge=-1e6, le=1e6, description="ppm")]


def time_offset(log: Recording, seconds: Seconds = 0.1) -> None:
    """Detections are stamped S too late; negative: too early."""
    log.restamp_scans(lambda stamp_ns: stamp_ns + seconds_ns(seconds))


def detections_clock_back(log: Recording, seconds: Duration = 30.0) -> None:
    """The clock of the detections is S behind from half time on."""
    half_ns = log.stamp_at(0.5)
    log.restamp_scans(lambda stamp_ns: stamp_ns - seconds_ns(seconds) * (stamp_ns >= half_ns))


def detections_clock_slow(log: Recording, parts_per_million: _Ppm = 200.0) -> None:
    """The clock of the detections is slow by so many parts in a million."""
    first_ns = log.stamp_at(0.0)
    log.restamp_scans(lambda stamp_ns: stamp_ns - round((stamp_ns - first_ns) * parts_per_million * 1e-6))


def stamps_in_microseconds(log: Recording) -> None:
    """Stamps of detections are in microseconds instead of nanoseconds."""
    log.restamp_scans(lambda stamp_ns: stamp_ns // 1000)


def scan_rate(log: Recording, rate_hz: Hertz = 1.0) -> None:
    """Detections come at HZ at most."""
    stamps_ns = np.array([scan.stamp_ns for scan in log.scans], dtype=np.int64)
    ordered = np.unique(stamps_ns)
    # Half a nanosecond more keeps stamps that stand exactly at the period's ends.
    periods = np.floor((ordered - ordered[:1] + 0.5) * 1e-9 * rate_hz)
    first_of_each = ordered[np.unique(periods, return_index=True)[1]]
    log.scans = list(compress(log.scans, np.isin(stamps_ns, first_of_each)))


def detections_stop(log: Recording, fraction: Part = 0.5) -> None:
    """No detections come from a part of the drive on."""
    begin_ns = log.stamp_at(fraction)
    log.scans = [scan for scan in log.scans if scan.stamp_ns < begin_ns]


def odometry_pause(log: Recording, seconds: Duration = 10.0) -> None:
    """No odometry comes for S from half time on."""
    log.odometry = list(compress(log.odometry, ~log.are_after_half(seconds)))


def log_gap(log: Recording, seconds: Duration = 10.0) -> None:
    """Neither odometry nor detections come for S from half time on."""
    begin_ns, end_ns = log.from_half(seconds)
    odometry_pause(log, seconds)
    log.scans = [scan for scan in log.scans if not begin_ns <= scan.stamp_ns < end_ns]


def messages_twice(log: Recording) -> None:
    """Each message of odometry and of detections comes twice."""
    log.odometry = [message for message in log.odometry for _ in range(2)]
    log.scans = [Scan(scan.message, scan.truth) for scan in log.scans for _ in range(2)]


def odometry_backwards(log: Recording, seconds: Duration = 10.0) -> None:
    """Stamps of the odometry fall instead of rising for S from half time on."""
    stamps_ns = np.where(log.are_after_half(seconds), sum(log.from_half(seconds)) - log.stamps_ns, log.stamps_ns)
    pairs = zip(log.odometry, stamps_ns.tolist(), strict=True)
    log.odometry = [message.having(stamp_ns=stamp_ns) for message, stamp_ns in pairs]
