"""Faults of stamps, rates and gaps."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from slam.simulation.faults.fault import Duration, Hertz, Seconds, fault
from slam.simulation.faults.recording import Recording, seconds_ns

_Ppm = Annotated[float, Field(ge=-1e6, le=1e6, description="ppm")]


@fault("0.05", "0.1", "0.5", "2", "-0.1", "-0.5")
def time_offset(log: Recording, seconds: Seconds = 0.1) -> Recording:
    """Detections are stamped S too late; negative: too early."""
    return log.restamped(lambda stamp_ns: stamp_ns + seconds_ns(seconds))


@fault()
def detections_clock_back(log: Recording, seconds: Duration = 30.0) -> Recording:
    """The clock of the detections is S behind from the middle of the drive on."""
    half_ns = log.half_ns
    return log.restamped(lambda stamp_ns: stamp_ns - seconds_ns(seconds) * (stamp_ns >= half_ns))


@fault()
def odometry_clock_back(log: Recording, seconds: Duration = 30.0) -> Recording:
    """The clock of the odometry is S behind from the middle of the drive on."""
    late_ns = seconds_ns(seconds) * (log.stamps_ns >= log.half_ns)
    return _with_stamps(log, (log.stamps_ns - late_ns).tolist())


@fault()
def detections_clock_slow(log: Recording, parts_per_million: _Ppm = 200.0) -> Recording:
    """The clock of the detections is slow by so many parts in a million."""
    first_ns, _ = log.span_ns
    return log.restamped(lambda stamp_ns: stamp_ns - round((stamp_ns - first_ns) * parts_per_million * 1e-6))


@fault()
def stamps_coarse(log: Recording, seconds: Duration = 1.0) -> Recording:
    """Stamps of detections are cut to multiples of S."""
    unit_ns = max(seconds_ns(seconds), 1)
    return log.restamped(lambda stamp_ns: stamp_ns // unit_ns * unit_ns)


@fault()
def stamps_in_microseconds(log: Recording) -> Recording:
    """Stamps of detections are in microseconds instead of nanoseconds."""
    return log.restamped(lambda stamp_ns: stamp_ns // 1000)


@fault("1", "0.5")
def scan_rate(log: Recording, rate_hz: Hertz = 1.0) -> Recording:
    """Detections come at HZ at most."""
    kept = _thinned([scan.stamp_ns for scan in log.scans], rate_hz)
    return log.select_scans(kept.__contains__)


@fault()
def frame_rate(log: Recording, rate_hz: Hertz = 1.0) -> Recording:
    """Odometry and detections come at HZ at most."""
    kept = _thinned(log.stamps_ns.tolist(), rate_hz)
    return scan_rate.function(_select_odometry(log, [stamp_ns in kept for stamp_ns in log.stamps_ns.tolist()]), rate_hz)


@fault()
def odometry_pause(log: Recording, seconds: Duration = 10.0) -> Recording:
    """No odometry comes for S from the middle of the drive on."""
    begin_ns, end_ns = log.from_half(seconds)
    return _select_odometry(log, ((log.stamps_ns < begin_ns) | (log.stamps_ns >= end_ns)).tolist())


@fault()
def log_gap(log: Recording, seconds: Duration = 10.0) -> Recording:
    """Neither odometry nor detections come for S from the middle of the drive on."""
    begin_ns, end_ns = log.from_half(seconds)
    without = log.select_scans(lambda stamp_ns: not begin_ns <= stamp_ns < end_ns)
    return replace(without, odometry=odometry_pause.function(log, seconds).odometry)


@fault()
def messages_twice(log: Recording) -> Recording:
    """Each message of odometry and of detections comes twice."""
    odometry = tuple(message for message in log.odometry for _ in range(2))
    return replace(log, odometry=odometry, scans=tuple(scan for scan in log.scans for _ in range(2)))


@fault()
def odometry_backwards(log: Recording, seconds: Duration = 10.0) -> Recording:
    """Stamps of the odometry fall instead of rising for S from the middle of the drive on."""
    begin_ns, end_ns = log.from_half(seconds)
    falls = (log.stamps_ns >= begin_ns) & (log.stamps_ns < end_ns)
    return _with_stamps(log, np.where(falls, begin_ns + end_ns - log.stamps_ns, log.stamps_ns).tolist())


def _with_stamps(log: Recording, stamps_ns: list[int]) -> Recording:
    """Other stamps (N,) of the odometry."""
    pairs = zip(log.odometry, stamps_ns, strict=True)
    return replace(log, odometry=tuple(message.with_fields(stamp_ns=stamp_ns) for message, stamp_ns in pairs))


def _select_odometry(log: Recording, is_kept: list[bool]) -> Recording:
    pairs = zip(log.odometry, is_kept, strict=True)
    return replace(log, odometry=tuple(message for message, kept in pairs if kept))


def _thinned(stamps_ns: list[int], rate_hz: float) -> set[int]:
    """Of the stamps, the first of each period of the rate."""
    ordered = np.unique(np.array(stamps_ns, dtype=np.int64))
    # Half a nanosecond more keeps stamps that stand exactly at the period's ends.
    periods = np.floor((ordered - ordered[:1] + 0.5) * 1e-9 * rate_hz).astype(np.int64)
    return set(ordered[np.unique(periods, return_index=True)[1]].tolist())
