"""Maps a robot while it drives: each message gives estimates immediately."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from logs.messages import Record
from logs.reader import LogItem
from logs.writer import LogWriter
from slam.common.config import Config
from slam.final_map import FinalMap
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.sensor_frames import SensorFrames
from slam.frontend.input.stamp_clocks import StampClocks
from slam.live_slam import LiveSlam
from slam.localization.prior_map import PriorMap
from slam.log_mapper import LogMapper
from slam.output_log import OutputLog


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
        frames, clocks = SensorFrames(), StampClocks()
        self.slam = LiveSlam(config, prior_map, frames=frames, delays=clocks.delays)
        self._stack = ExitStack()
        self._stack.enter_context(threadpool_limits(1, user_api="blas"))
        writer = None if output is None else self._stack.enter_context(LogWriter(output))
        log = OutputLog(writer, publish, None)
        self._mapper = LogMapper(self.slam, InputRecords(config, LabelMap(config.labels), frames), clocks, log)
        self._log_time_ns = 0

    def __enter__(self) -> LiveDrive:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.__exit__(*error)  # type: ignore[arg-type]

    def process(self, item: LogItem) -> None:
        """Map the next message, and publish what it makes known."""
        self._log_time_ns = max(self._log_time_ns, item.raw.log_time_ns)
        self._mapper.process(item, self._log_time_ns)

    def finish(self, counters: Mapping[str, int] | None = None) -> FinalMap:
        """Optimise everything at once, and publish the result; ``counters``: of what was read.

        Raises:
            InputDataError: there was nothing to map.
        """
        final = self._mapper.finish(self._log_time_ns, counters or {})
        self._mapper.log.write_final(final, None, self._log_time_ns)
        return final

    def latency_s(self) -> dict[str, float]:
        """How long messages took on this machine: the median, the 99th percentile and the longest, in seconds."""
        if not self._mapper.seconds:
            return {}
        median, most, longest = np.percentile(self._mapper.seconds, [50.0, 99.0, 100.0]).tolist()
        return {"p50": median, "p99": most, "max": longest}
