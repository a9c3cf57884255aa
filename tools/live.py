"""dslam live."""

import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import CalibrationFile, ConfigFile, Json, Settings, Topics, check_outputs, parse_topics

if TYPE_CHECKING:
    from logs.reader import LogItem, LogReader
    from slam.common.config import Config


def live(
    source: Annotated[Path, typer.Argument(metavar="LOG|-", help="A log, or '-' for a stream on standard input.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="OUT.mcap", help="Also write the estimates to a log.")
    ] = None,
    speed: Annotated[
        float,
        typer.Option(min=0.0, metavar="FACTOR", help="Speed of a log relative to real time; 0: as fast as possible."),
    ] = 1.0,
    host: Annotated[str, typer.Option(metavar="HOST", help="Address to listen on for Foxglove.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, metavar="PORT", help="Port to listen on; 0: any free port.")
    ] = 8765,
    map_log: Annotated[
        Path | None, typer.Option("--map", metavar="MAP.mcap", help="Localize the robot in this map.")
    ] = None,
    config_file: ConfigFile = None,
    calibration: CalibrationFile = None,
    settings: Settings = None,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Map a drive while it happens, and publish the estimates to Foxglove.

    A stream holds dslam.StreamMessage records, each after its length as a varint (logs/schemas/dslam.proto). The
    estimates use past records only, and so do values that are missing in the calibration.

    Example: dslam live drive.mcap --speed 2 --calibration robot.toml
    """
    chosen = parse_topics(topics)
    check_outputs([output], [config_file, calibration, map_log, source])
    from logs.reader import LogReader
    from logs.storage.stream import read_stream
    from slam.common.config import load_config
    from slam.display.foxglove_feed import FoxgloveFeed
    from slam.live_drive import map_live
    from slam.localization.prior_map import load_prior_map
    from tools import console

    config = load_config(config_file, settings, calibration=calibration)
    prior_map = None if map_log is None else load_prior_map(map_log)
    counters = Counter[str]()
    with ExitStack() as stack:
        feed = stack.enter_context(closing(FoxgloveFeed(host, port)))
        typer.echo(f"Foxglove: ws://{host}:{feed.port}", err=True)
        if source == Path("-"):
            items = read_stream(sys.stdin.buffer, counters, config.reading_limits)
        else:
            items = _at_speed(stack.enter_context(LogReader(source, config.reading_limits)), config, chosen, speed)
        final, mapper = map_live(items, counters, config, feed.show, prior_map=prior_map, output=output)
    figures = {
        "output": output,
        "latency_s": mapper.latency_s(),
        "status": final.status.message,
        "notes": mapper.slam.calibration.notes,
        "counters": final.status.counters,
    }
    console.report(figures, as_json=json)


def _at_speed(reader: "LogReader", config: "Config", topics: dict[str, str], speed: float) -> "Iterator[LogItem]":
    """The messages of a log, each not before its time."""
    import time

    from logs.topics import RecordKind
    from slam.prepared_log import prepare_log

    prepared = prepare_log(reader, config, topics=topics, copy=(), is_surveyed=False)
    selection = prepared.selection.without(RecordKind.GROUND_TRUTH, RecordKind.DETECTION_TRUTH, RecordKind.OBJECT_TRUTH)
    started = time.monotonic()
    for item in reader.items(selection):
        if speed > 0.0:
            due = started + (item.raw.log_time_ns - prepared.first_ns) * 1e-9 / speed
            time.sleep(max(due - time.monotonic(), 0.0))
        yield item
