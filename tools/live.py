"""dslam live."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, BinaryIO

import typer

from tools.arguments import CalibrationFile, ConfigFile, Json, Settings, Topics, check_outputs, parse_topics

if TYPE_CHECKING:
    from logs.reader import LogItem
    from slam.common.config import Config

STANDARD_INPUT, SOCKET = "-", "tcp:"


def live(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A log, '-' for standard input, or tcp:HOST:PORT to listen on for one sender.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="OUT.mcap", help="Also write the estimates to a log.", show_default=False
        ),
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
        Path | None,
        typer.Option("--map", metavar="MAP.mcap", help="Localize the robot in this map.", show_default=False),
    ] = None,
    config_file: ConfigFile = None,
    calibration: CalibrationFile = None,
    settings: Settings = None,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Map a drive while it happens, and publish the estimates to Foxglove.

    A stream holds dslam.StreamMessage records, each after its length as a varint (logs/schemas/dslam.proto). The
    estimates use past records only, also for values that the calibration does not hold.
    Example: dslam live drive.mcap --speed 2 --calibration robot.toml
    """
    chosen, address = parse_topics(topics), _parse_address(source)
    check_outputs([output], [config_file, calibration, map_log, *([] if _is_stream(source) else [Path(source)])])
    from slam.common.config import load_config
    from slam.display.foxglove_feed import FoxgloveFeed
    from slam.live_drive import LiveDrive
    from slam.localization.prior_map import load_prior_map
    from tools import console

    config = load_config(config_file, settings or (), calibration=calibration)
    prior_map = None if map_log is None else load_prior_map(map_log)
    counters = Counter[str]()
    with ExitStack() as stack:
        feed = stack.enter_context(FoxgloveFeed(host, port))
        typer.echo(f"Foxglove: ws://{host}:{feed.port}", err=True)
        drive = stack.enter_context(LiveDrive(config, feed.show, prior_map=prior_map, output=output))
        for item in _items(stack, source, address, config, chosen, speed, counters):
            drive.process(item)
        drive.slam.counters.update(counters)
        final = drive.finish()
    latency_s = drive.latency_s()
    if json:
        console.show_json({"latency_s": latency_s, "status": final.status.message, "counters": final.status.counters})
        return
    rows = {
        "latency": ", ".join(f"{name} {1e3 * seconds:.1f} ms" for name, seconds in latency_s.items()),
        "landmarks": str(len(final.object_map.ids)),
        "of the robot": "; ".join((*drive.slam.calibration.notes, *drive.slam.calibration.suspicions)),
        "final status": final.status.message,
        "written": "" if output is None else str(output),
    }
    console.show(console.pairs({name: text for name, text in rows.items() if text}))


def _is_stream(source: str) -> bool:
    return source == STANDARD_INPUT or source.startswith(SOCKET)


def _items(
    stack: ExitStack,
    source: str,
    address: tuple[str, int] | None,
    config: Config,
    topics: dict[str, str] | None,
    speed: float,
    counters: Counter[str],
) -> Iterator[LogItem]:
    from logs.storage.stream import read_stream

    if source == STANDARD_INPUT:
        return read_stream(sys.stdin.buffer, counters, config.reading_limits)
    if address is not None:
        return read_stream(stack.enter_context(_accepted(address)), counters, config.reading_limits)
    return _at_speed(stack, Path(source), config, topics, speed)


def _at_speed(
    stack: ExitStack, path: Path, config: Config, topics: dict[str, str] | None, speed: float
) -> Iterator[LogItem]:
    """The messages of a log, each not before its time."""
    import time

    from logs.reader import LogReader
    from logs.topics import RecordKind
    from slam.prepared_log import prepare_log

    reader = stack.enter_context(LogReader(path, config.reading_limits))
    selection = prepare_log(reader, config, topics=topics, copy=(), is_surveyed=False).selection
    for kind in (RecordKind.GROUND_TRUTH, RecordKind.DETECTION_TRUTH, RecordKind.OBJECT_TRUTH):
        selection = selection.without(kind)
    started, first_ns = time.monotonic(), None
    for item in reader.items(selection):
        first_ns = item.raw.log_time_ns if first_ns is None else first_ns
        if speed > 0.0:
            due = started + (item.raw.log_time_ns - first_ns) * 1e-9 / speed
            time.sleep(max(due - time.monotonic(), 0.0))
        yield item


def _parse_address(source: str) -> tuple[str, int] | None:
    """Host and port of tcp:HOST:PORT; None for another source."""
    if not source.startswith(SOCKET):
        return None
    host, _, port = source.removeprefix(SOCKET).rpartition(":")
    if not host or not port.isdigit():
        raise typer.BadParameter(f"{source}: expected {SOCKET}HOST:PORT.", param_hint="SOURCE")
    return host, int(port)


def _accepted(address: tuple[str, int]) -> BinaryIO:
    """The stream of the first program that connects to the address."""
    import socket

    with socket.create_server(address) as server:
        connection, _ = server.accept()
        with connection:
            return connection.makefile("rb")
