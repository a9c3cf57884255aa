"""Maps a robot while it drives: each message gives estimates immediately."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from logs.messages import Record
from logs.reader import LogItem
from logs.writer import LogWriter
from slam.common.config import Config
from slam.display.drive_display import DriveDisplay
from slam.final_map import FinalMap
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.sensor_frames import SensorFrames
from slam.frontend.input.stamp_clocks import StampClocks
from slam.live_slam import LiveSlam
from slam.localization.prior_map import PriorMap
from slam.output_log import OutputLog

PERCENTILES = {"p50": 50.0, "p99": 99.0, "max": 100.0}


class LiveDrive:
    """Maps messages one by one; a context manager that writes ``output``, if one is given, and finishes it.

    ``publish`` is called with topic, record and log time of each update.
    """

    def __init__(
        self,
        config: Config,
        publish: Callable[[str, Record, int], None],
        *,
        prior_map: PriorMap | None = None,
        output: Path | None = None,
    ) -> None:
        frames = SensorFrames()
        self._clocks = StampClocks()
        self.slam = LiveSlam(config, prior_map, frames=frames, delays=self._clocks.delays)
        self._inputs = InputRecords(config, LabelMap(config.labels), frames)
        self._stack = ExitStack()
        self._stack.enter_context(threadpool_limits(1, user_api="blas"))
        writer = None if output is None else self._stack.enter_context(LogWriter(output))
        self._log = OutputLog(writer, DriveDisplay(), publish, None)
        self._log_time_ns = 0
        self._seconds: list[float] = []

    def __enter__(self) -> LiveDrive:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.__exit__(*error)  # type: ignore[arg-type]

    def process(self, item: LogItem) -> None:
        """Map the next message, and publish the updates."""
        started = time.perf_counter()
        self._log_time_ns = max(self._log_time_ns, item.raw.log_time_ns)
        for record in self._inputs.prepare(self._clocks.follow(item)):
            self._log.write_updates(self.slam.process(record), self._log_time_ns)
            if (snapshot := self.slam.snapshot()) is not None:
                self._log.write_snapshot(snapshot, self._log_time_ns)
        self._seconds.append(time.perf_counter() - started)

    def finish(self) -> FinalMap:
        """Optimise the whole graph, and publish the result.

        Raises:
            InputDataError: there was nothing to map.
        """
        for record in self._inputs.prepare(self._clocks.finish()):
            self._log.write_updates(self.slam.process(record), self._log_time_ns)
        self._inputs.check()
        self._log.write_updates(self.slam.catch_up(), self._log_time_ns)
        final = self.slam.finish()
        self._log.write_final(final, None, self._log_time_ns)
        return final

    def latency_s(self) -> dict[str, float]:
        """How long messages took on this machine: the median, the 99th percentile and the longest, in seconds."""
        if not self._seconds:
            return {}
        values = np.percentile(self._seconds, list(PERCENTILES.values()))
        return dict(zip(PERCENTILES, values.tolist(), strict=True))
