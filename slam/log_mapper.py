"""The messages of a log, from a file or as they come: through the estimator into the output."""

from __future__ import annotations

import time
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from logs.messages import GeodeticFix, Record
from logs.reader import LogItem
from slam.final_map import FinalMap
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.stamp_clocks import StampClocks
from slam.live_slam import LiveSlam
from slam.output_log import OutputLog


class LogMapper:
    """Maps messages one by one, and writes what each makes known.

    ``fixes``: those of a satellite receiver.
    """

    def __init__(self, slam: LiveSlam, inputs: InputRecords, clocks: StampClocks, log: OutputLog) -> None:
        self.slam = slam
        self.log = log
        self.clocks = clocks
        self.fixes: list[GeodeticFix] = []
        self._seconds = array("d")
        self._inputs = inputs

    def process(self, item: LogItem, log_time_ns: int) -> None:
        """Map the next message; what it makes known is written at a log time."""
        started = time.perf_counter()
        self._map(self.clocks.follow(item), log_time_ns)
        self._seconds.append(time.perf_counter() - started)

    def finish(self, log_time_ns: int, counters: Mapping[str, int]) -> FinalMap:
        """Map what still waits, and optimise everything at once; ``counters``: of what was read.

        Raises:
            InputDataError: there was nothing to map.
        """
        self._map(self.clocks.finish(), log_time_ns)
        self._inputs.check()
        self.log.write_updates(self.slam.catch_up(), log_time_ns)
        self.slam.counters.update(Counter(counters) + self._inputs.counters)
        return self.slam.finish()

    def latency_s(self) -> dict[str, float]:
        """How long messages took on this machine: the median, the 99th percentile and the longest, in seconds."""
        if not self._seconds:
            return {}
        median, most, longest = np.percentile(self._seconds, [50.0, 99.0, 100.0]).round(4).tolist()
        return {"p50": median, "p99": most, "max": longest}

    def _map(self, records: Iterable[Record], log_time_ns: int) -> None:
        for record in self._inputs.prepare(records):
            if isinstance(record, GeodeticFix):
                self.fixes.append(record)
            self.log.write_updates(self.slam.process(record), log_time_ns)
            if (snapshot := self.slam.snapshot()) is not None:
                self.log.write_messages(snapshot, log_time_ns)
