"""Faults of stamps, rates and gaps."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from logs.messages import ObjectDetections, Odometry
from slam.common.arrays import IntArray
from slam.simulation.faults.fault import DETECTIONS, ODOMETRY, SCANS, Duration, Hertz, Range, Seconds, fault
from slam.simulation.faults.stream import (
    HALF,
    Entry,
    Stream,
    keep_scans,
    odometry_of,
    restamp_scans,
    scans_of,
    seconds_ns,
    span_from_half,
    stamp_at,
)

_Ppm = Annotated[float, Range("ppm", min=-1e6, max=1e6)]


@fault(SCANS, neutral=0.0, cases=("0.05", "0.1", "0.5", "2", "-0.1", "-0.5"))
def time_offset(stream: Stream, seconds: Seconds = 0.1) -> list[Entry]:
    """Detections are stamped S too late; negative: too early."""
    return restamp_scans(stream, lambda stamp_ns: stamp_ns + seconds_ns(seconds))


@fault(SCANS)
def detections_clock_back(stream: Stream, seconds: Duration = 30.0) -> list[Entry]:
    """The clock of the detections is S behind from half time on."""
    begin_ns = stamp_at(stream, HALF)
    return restamp_scans(stream, lambda stamp_ns: stamp_ns - seconds_ns(seconds) * (stamp_ns >= begin_ns))


@fault(ODOMETRY)
def odometry_clock_back(stream: Stream, seconds: Duration = 30.0) -> list[Entry]:
    """The clock of the odometry is S behind from half time on."""
    begin_ns = stamp_at(stream, HALF)
    return [
        e.with_fields(stamp_ns=e.stamp_ns - seconds_ns(seconds))
        if isinstance(e.content, Odometry) and e.stamp_ns >= begin_ns
        else e
        for e in stream
    ]


@fault(SCANS)
def detections_clock_slow(stream: Stream, parts_per_million: _Ppm = 200.0) -> list[Entry]:
    """The clock of the detections is slow by so many parts in a million."""
    first_ns = stamp_at(stream, 0.0)
    return restamp_scans(stream, lambda stamp_ns: stamp_ns - round((stamp_ns - first_ns) * parts_per_million * 1e-6))


@fault(SCANS)
def stamps_coarse(stream: Stream, seconds: Duration = 1.0) -> list[Entry]:
    """Stamps of detections are cut to multiples of S."""
    unit_ns = max(seconds_ns(seconds), 1)
    return restamp_scans(stream, lambda stamp_ns: stamp_ns // unit_ns * unit_ns)


@fault(SCANS)
def stamps_in_microseconds(stream: Stream) -> list[Entry]:
    """Stamps of detections are in microseconds instead of nanoseconds."""
    return restamp_scans(stream, lambda stamp_ns: stamp_ns // 1000)


@fault(SCANS, cases=("1", "0.5"))
def scan_rate(stream: Stream, rate_hz: Hertz = 1.0) -> list[Entry]:
    """Detections come at HZ at most."""
    return _thinned_scans(stream, rate_hz)


@fault((*ODOMETRY, *SCANS))
def frame_rate(stream: Stream, rate_hz: Hertz = 1.0) -> list[Entry]:
    """Odometry and detections come at HZ at most."""
    kept_odometry = set(_thinned(np.unique(odometry_of(stream)[0]), rate_hz).tolist())
    thinned = [e for e in stream if not isinstance(e.content, Odometry) or e.stamp_ns in kept_odometry]
    return _thinned_scans(thinned, rate_hz)


@fault(ODOMETRY)
def odometry_pause(stream: Stream, seconds: Duration = 10.0) -> list[Entry]:
    """No odometry comes for S from half time on."""
    begin_ns, end_ns = span_from_half(stream, seconds)
    return [e for e in stream if not (isinstance(e.content, Odometry) and begin_ns <= e.stamp_ns < end_ns)]


@fault((*ODOMETRY, *SCANS))
def log_gap(stream: Stream, seconds: Duration = 10.0) -> list[Entry]:
    """Neither odometry nor detections come for S from half time on."""
    begin_ns, end_ns = span_from_half(stream, seconds)
    return keep_scans(odometry_pause.function(stream, seconds), lambda stamp_ns: not begin_ns <= stamp_ns < end_ns)


@fault((*ODOMETRY, *DETECTIONS))
def messages_twice(stream: Stream) -> list[Entry]:
    """Each message of odometry and of detections comes twice."""
    twice = (Odometry, ObjectDetections)
    return [each for entry in stream for each in ([entry, entry] if isinstance(entry.content, twice) else [entry])]


@fault(ODOMETRY)
def odometry_backwards(stream: Stream, seconds: Duration = 10.0) -> list[Entry]:
    """Stamps of the odometry fall instead of rising for S from half time on."""
    begin_ns, end_ns = span_from_half(stream, seconds)
    return [
        e.with_fields(stamp_ns=begin_ns + end_ns - e.stamp_ns)
        if isinstance(e.content, Odometry) and begin_ns <= e.stamp_ns < end_ns
        else e
        for e in stream
    ]


def _thinned_scans(stream: Stream, rate_hz: float) -> list[Entry]:
    stamps_ns = np.unique([s.stamp_ns for s in scans_of(stream)])
    kept = set(_thinned(stamps_ns, rate_hz).tolist())
    return keep_scans(stream, lambda stamp_ns: stamp_ns in kept)


def _thinned(stamps_ns: IntArray, rate_hz: float) -> IntArray:
    """Of the rising stamps (N,), the first of each period of the rate."""
    if len(stamps_ns) == 0:
        return stamps_ns
    # Half a nanosecond more keeps stamps that stand exactly at the period's ends.
    periods = np.floor((stamps_ns - stamps_ns[0] + 0.5) * 1e-9 * rate_hz).astype(np.int64)
    return np.asarray(stamps_ns[np.unique(periods, return_index=True)[1]])
