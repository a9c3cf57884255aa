"""The clocks of a log's stamps against the clock of its logger.

A message is made, stamped, and logged some time later. That time is much the same from message to message of a topic,
whatever the two clocks show. Where it changes and stays changed, either messages take longer, or the clock of the
stamps was set. Two signs reveal a clock that was set: stamps restart before the last one, though messages are logged as
before, or stamps are suddenly later than their log times.
"""

from __future__ import annotations

from array import array
from collections import defaultdict, deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from statistics import median_low

import numpy as np

from logs.messages import ImageDetections, LabelledScan, ObjectDetections, Odometry, Record
from logs.reader import LogItem
from logs.records import frozen

MIN_MESSAGES = 16
"""Messages of a topic that are needed to distinguish a step of its clock from jitter, or to tell its drift."""
CONFIRMING = 5
"""Messages in a row that show the same step: single stamps are wrong for other reasons."""

Stamped = Odometry | ObjectDetections | ImageDetections | LabelledScan


@dataclass(frozen=True, slots=True)
class LoggingDelays:
    """Seconds from the stamps of the odometry and of the detections to when they were logged, medians."""

    odometry_s: float = 0.0
    detections_s: float = 0.0

    def blame_detections(self, delay_s: float) -> bool | None:
        """Whether detections that are of another time than the odometry, later by ``delay_s`` than their stamps say,
        have the wrong stamps, rather than the odometry; None where log times are but copies of the stamps.

        Nothing is logged before it was made, and little long after.
        """
        if self.odometry_s == 0.0 and self.detections_s == 0.0:
            return None
        if_detections = _badness(self.odometry_s) + _badness(self.detections_s - delay_s)
        if_odometry = _badness(self.odometry_s + delay_s) + _badness(self.detections_s)
        return if_detections < if_odometry


def _badness(delay_s: float) -> float:
    """A message that was logged before it was made counts ten times as much as one that was logged late."""
    return delay_s if delay_s >= 0.0 else -10.0 * delay_s


@frozen
class ClockStep:
    """The clock of a topic was set forward by ``step_ns``, as was known by its stamp ``stamp_ns``."""

    topic: str
    stamp_ns: int
    step_ns: int

    def __str__(self) -> str:
        direction = "forward" if self.step_ns > 0 else "back"
        return (
            f"the clock of {self.topic} was set {direction} by {abs(self.step_ns) * 1e-9:.3f} s before its stamp "
            f"{self.stamp_ns * 1e-9:.3f} s: later stamps are corrected by the log times"
        )


@frozen
class ClockDrift:
    """The clock of detections loses ``rate`` seconds in a second of the odometry's, from the stamp ``since_ns`` on."""

    rate: float = 0.0
    since_ns: int = 0

    def correct(self, record: Stamped) -> Stamped:
        """The record by a clock that keeps time."""
        if self.rate == 0.0 or isinstance(record, Odometry):
            return record
        return replace(record, stamp_ns=record.stamp_ns + round(self.rate * (record.stamp_ns - self.since_ns)))

    def __str__(self) -> str:
        return (
            f"the clock of detections is {'slow' if self.rate > 0 else 'fast'} by {1e6 * abs(self.rate):.0f} parts in "
            "a million relative to that of the odometry, by the log times: corrected"
        )


NO_DRIFT = ClockDrift()


class StampClocks:
    """Follows the messages of a log in its order, and takes steps of the clocks, and a known ``drift``, off their
    stamps.
    """

    def __init__(self, drift: ClockDrift = NO_DRIFT) -> None:
        self._drift = drift
        self._topics: defaultdict[str, _TopicClock] = defaultdict(_TopicClock)
        # Of the odometry and of the detections.
        self._logged: defaultdict[bool, array[int]] = defaultdict(lambda: array("q"))
        self._delays: defaultdict[bool, array[int]] = defaultdict(lambda: array("q"))
        self.steps: list[ClockStep] = []

    def follow(self, item: LogItem) -> Iterator[Record]:
        """The records that are ready, those of ``item`` mostly; others wait for what follows them."""
        if len(item.records) != 1 or not isinstance(record := item.records[0], Stamped):
            yield from item.records
            return
        logged_ns, topic = item.raw.log_time_ns, item.raw.topic
        record = self._drift.correct(record)
        self._delays[isinstance(record, Odometry)].append(logged_ns - record.stamp_ns)
        self._logged[isinstance(record, Odometry)].append(logged_ns)
        ready, step_ns = self._topics[topic].follow(record, logged_ns)
        if step_ns:
            self.steps.append(ClockStep(topic, record.stamp_ns, step_ns))
        yield from ready

    def finish(self) -> Iterator[Record]:
        """The waiting records, unchanged."""
        for clock in self._topics.values():
            yield from clock.release()

    def drift(self) -> ClockDrift:
        """Drift of the clock of the detections against that of the odometry; none if a clock was set.

        A drift of less than a tenth of the interval between scans in the whole log does no harm. Oscillators keep time
        to a thousandth; where delays grow faster, messages queue.
        """
        if self.steps or len(self._delays[False]) < MIN_MESSAGES:
            return NO_DRIFT
        rates = [_rate(self._logged[of_odometry], self._delays[of_odometry]) for of_odometry in (False, True)]
        rate, seconds = rates[0] - rates[1], self._length_ns * 1e-9
        interval_s = seconds / len(self._delays[False])
        if not 0.1 * interval_s < abs(rate) * seconds < 1e-3 * seconds:
            return NO_DRIFT
        return ClockDrift(rate, self._logged[False][0] - self._delays[False][0])

    @property
    def _length_ns(self) -> int:
        """Time in which all messages so far were logged."""
        return int(np.ptp(np.concatenate([*self._logged.values()])))

    def delays(self) -> LoggingDelays:
        """The delays of all messages so far; empty if they exceed the length of the log, whose clock then has another
        origin.
        """
        odometry, detections = (self._delays[of_odometry] for of_odometry in (True, False))
        if not odometry or not detections:
            return LoggingDelays()
        of_odometry_ns, of_detections_ns = median_low(odometry), median_low(detections)
        if max(abs(of_odometry_ns), abs(of_detections_ns)) > self._length_ns:
            return LoggingDelays()
        return LoggingDelays(of_odometry_ns * 1e-9, of_detections_ns * 1e-9)


def _rate(logged_ns: array[int], delays_ns: array[int]) -> float:
    """Growth of the least delays in a unit of time, where it is significant: nothing is logged sooner than it can be.

    The least delays of blocks lie on the line of the clocks (Moon, Skelly and Towsley, INFOCOM 1999).
    """
    count = 16
    if len(logged_ns) < count:
        return 0.0
    rows = [block[np.argmin(np.array(delays_ns)[block])] for block in np.array_split(np.arange(len(logged_ns)), count)]
    times, least = ((np.array(values)[rows] - values[0]) * 1e-9 for values in (logged_ns, delays_ns))
    A = np.column_stack([times, np.ones(count)])
    line, *_ = np.linalg.lstsq(A, least)
    scatter = float(np.sqrt(np.sum((least - A @ line) ** 2) / (count - 2)))
    is_significant = abs(line[0]) * float(np.ptp(times)) > 6.0 * scatter
    return float(line[0]) if is_significant else 0.0


class _TopicClock:
    """The clock of one topic: what it was set by so far is added to its stamps."""

    def __init__(self) -> None:
        self._shift_ns = 0
        self._delays: deque[int] = deque(maxlen=2 * MIN_MESSAGES)  # by the corrected stamps
        self._intervals: deque[int] = deque(maxlen=2 * MIN_MESSAGES)
        self._logged_ns: int | None = None
        self._latest_ns = 0
        self._waiting: list[Stamped] = []
        self._waiting_delays: list[int] = []

    def follow(self, record: Stamped, logged_ns: int) -> tuple[list[Stamped], int]:
        """The messages that are ready, and by how much [ns] they show that the clock was set forward, mostly 0."""
        delay_ns = logged_ns - record.stamp_ns - self._shift_ns
        if self._logged_ns is not None:
            self._intervals.append(logged_ns - self._logged_ns)
        self._logged_ns = logged_ns
        if len(self._delays) < MIN_MESSAGES:
            self._delays.append(delay_ns)
            return [self._corrected(record)], 0
        least_ns, most_ns = min(self._delays), max(self._delays)
        usual_ns, tolerance_ns = delay_ns, 0
        if not least_ns <= delay_ns <= most_ns:  # else it is within any tolerance
            usual_ns = median_low(self._delays)
            tolerance_ns = median_low(self._intervals) + most_ns - least_ns
        if abs(delay_ns - usual_ns) <= 2.0 * tolerance_ns:
            self._delays.append(delay_ns)
            return [*self.release(), self._corrected(record)], 0
        is_steady = all(abs(delay_ns - each) <= tolerance_ns for each in self._waiting_delays)
        ready = [] if is_steady else self.release()
        self._waiting.append(record)
        self._waiting_delays.append(delay_ns)
        if len(self._waiting) < CONFIRMING:
            return ready, 0
        now_ns = median_low(self._waiting_delays)
        # Else messages just take longer, or less long, than before.
        is_set_back = now_ns >= usual_ns and self._waiting[0].stamp_ns + self._shift_ns <= self._latest_ns
        is_set_forward = now_ns < min(usual_ns, 0)
        step_ns = usual_ns - now_ns if is_set_back or is_set_forward else 0
        self._shift_ns -= step_ns
        self._delays.clear()
        self._delays.extend(each + step_ns for each in self._waiting_delays)
        return ready + self.release(), step_ns

    def release(self) -> list[Stamped]:
        """The waiting records, with stamps by the current estimate of the clock."""
        ready = [self._corrected(record) for record in self._waiting]
        self._waiting, self._waiting_delays = [], []
        return ready

    def _corrected(self, record: Stamped) -> Stamped:
        corrected = replace(record, stamp_ns=record.stamp_ns + self._shift_ns) if self._shift_ns else record
        self._latest_ns = corrected.stamp_ns
        return corrected
