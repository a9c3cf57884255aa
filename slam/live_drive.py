"""Maps a robot while it drives: each message gives estimates immediately."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from pathlib import Path

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
from slam.log_mapper import LogMapper, OutputLog


def map_live(
    items: Iterable[LogItem],
    counters: Mapping[str, int],
    config: Config,
    publish: Callable[[str, Record, int], None],
    *,
    prior_map: PriorMap | None = None,
    output: Path | None,
) -> tuple[FinalMap, LogMapper]:
    """Map messages as they come, publish what each makes known, and optimise everything at the end.

    Args:
        items: the messages.
        counters: of what was read, when the messages end.
        config: of the estimator.
        publish: called with topic, record and log time of each update.
        prior_map: a map to localize in.
        output: a log to write as well.

    Raises:
        InputDataError: there was nothing to map.
        LogError: the input cannot be read or the output cannot be written.
    """
    frames, clocks = SensorFrames(), StampClocks()
    slam, log_time_ns = LiveSlam(config, prior_map, frames=frames, delays=clocks.delays), 0
    writing = nullcontext() if output is None else LogWriter(output)
    with threadpool_limits(1, user_api="blas"), writing as writer:
        inputs = InputRecords(config, LabelMap(config.labels), frames)
        writers = [publish] if writer is None else [writer.write, publish]
        mapper = LogMapper(slam, inputs, clocks, OutputLog(writers))
        for item in items:
            log_time_ns = max(log_time_ns, item.raw.log_time_ns)
            mapper.process(item, log_time_ns)
        final = mapper.finish(log_time_ns, counters)
        mapper.log.write_final(final, log_time_ns)
    return final, mapper
