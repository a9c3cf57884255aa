"""A log with faults put into it."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from logs.errors import UnwritableLogError
from logs.reader import LogReader
from logs.selection import Selection, select_topics
from logs.topics import RawMessage, RecordKind
from logs.writer import LogWriter, partial_path
from slam.common.errors import SimulationError
from slam.simulation.faults.registry import FaultCase
from slam.simulation.faults.stream import Entry

_NEEDED = (RecordKind.ODOMETRY, RecordKind.DETECTIONS)
_READING = 0.5  # part of the progress


@dataclass(frozen=True, slots=True)
class FaultSummary:
    """Messages of the output by topic, and what the input had lost already, by reason."""

    message_counts: dict[str, int]
    left_out: dict[str, int]


def apply_faults(stream: Sequence[Entry], cases: Sequence[FaultCase], *, seed: int) -> list[Entry]:
    """The messages with the faults, one after the other.

    Args:
        stream: all messages of a log; it stays as it is.
        cases: what to do. Random numbers are those of the seed, of the name of the fault, and of how often it came
            before, whatever other faults there are.
        seed: 0 or more.

    Raises:
        SimulationError: the messages are not those that a fault needs, or the seed is negative.
    """
    if seed < 0:
        raise SimulationError(f"seed {seed} is negative; give 0 or more")
    result = list(stream)
    times: Counter[str] = Counter()
    for case in cases:
        name = case.fault.name
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), times[name]])
        times[name] += 1
        try:
            result = case.fault.function(result, rng, *case.values)
        except SimulationError as error:
            raise SimulationError(f"fault {case.name}: {error}") from error
    return result


def write_faulty(
    source: Path,
    output: Path,
    cases: Sequence[FaultCase],
    *,
    seed: int,
    topics: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> FaultSummary:
    """Write the log ``source`` with faults as the log ``output``, with the metadata "faults".

    The whole log is held in memory. Topics that no fault changes are copied as they are, but that several transforms of
    one message become messages of their own where a fault looks at them; those that are changed are written as records.

    Args:
        source: a log with odometry and detections.
        output: replaced if it is there; written as NAME.part and renamed when finished.
        cases: what to do, in this order.
        seed: the same seed, faults and input give the same bytes.
        topics: kind -> topic, where the log leaves a choice.
        progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the input cannot be read or the output cannot be written.
        SimulationError: the log has not what a fault needs, or the seed is negative.
    """
    with LogReader(source) as reader:
        for path in (output, partial_path(output)):
            if path.exists() and path.samefile(source):
                raise UnwritableLogError(f"writing {output} would overwrite the input {source}; give another output")
        selection = _selection(reader, cases, topics)
        result = apply_faults(_read(reader, selection, progress), cases, seed=seed)
        written: Counter[str] = Counter()
        with LogWriter(output) as writer:
            _write_metadata(reader, writer, cases, seed)
            rewritten = {entry.topic for entry in result if _is_new(entry)}
            for done, entry in enumerate(result, start=1):
                raw = entry.content if isinstance(entry.content, RawMessage) else entry.raw
                if raw is not None and (entry.topic not in rewritten or isinstance(entry.content, RawMessage)):
                    writer.write_raw(raw)
                elif not isinstance(entry.content, RawMessage):
                    writer.write(entry.topic, entry.content, entry.log_time_ns)
                written[entry.topic] += 1
                if progress is not None:
                    progress(_READING + (1.0 - _READING) * done / len(result))
    return FaultSummary(dict(sorted(written.items())), reader.counters)


def _selection(reader: LogReader, cases: Sequence[FaultCase], topics: Mapping[str, str] | None) -> Selection:
    """The topics that are decoded: those that a fault changes or reads, and the two that tell the time of the drive.

    Raises:
        SimulationError: a topic that is to change plays several parts, as frames that are the odometry do.
    """
    changed = {kind for case in cases for kind in case.fault.changes}
    used = changed | {kind for case in cases for kind in case.fault.reads} | set(_NEEDED)
    selection = select_topics(reader.topics(), topics, needed=_NEEDED)
    for topic, kinds in selection.kinds.items():
        if len(kinds) > 1 and changed & set(kinds):
            raise SimulationError(
                f"{topic} is {' and '.join(kinds)} in one and cannot be rewritten; record a topic for each"
            )
    return Selection({topic: kinds for topic, kinds in selection.kinds.items() if used & set(kinds)})


def _read(reader: LogReader, selection: Selection, progress: Callable[[float], None] | None) -> list[Entry]:
    total = max(sum(info.message_count for info in reader.topics()), 1)
    entries: list[Entry] = []
    items = reader.items(selection, copy=[info.topic for info in reader.topics()])
    for done, item in enumerate(items, start=1):
        raw = item.raw
        if not item.records:
            entries.append(Entry(raw.topic, raw.log_time_ns, raw))
        elif len(item.records) == 1:
            entries.append(Entry(raw.topic, raw.log_time_ns, item.records[0], raw))
        else:  # several transforms in one message
            entries += [Entry(raw.topic, raw.log_time_ns, record) for record in item.records]
        if progress is not None:
            progress(min(_READING * done / total, _READING))
    return entries


def _is_new(entry: Entry) -> bool:
    return entry.raw is None and not isinstance(entry.content, RawMessage)


def _write_metadata(reader: LogReader, writer: LogWriter, cases: Sequence[FaultCase], seed: int) -> None:
    """What the input tells of itself, and how this log was made from it; later faults hide no earlier ones."""
    before = reader.metadata()
    for name, values in before.items():
        writer.add_metadata(name, values)
    taken = sum(name.partition("_")[0] == "faults" for name in before)
    writer.add_metadata(
        f"faults_{taken + 1}" if taken else "faults",
        {
            "version": version("descriptellation-slam"),
            "seed": str(seed),
            "input_sha256": reader.sha256(),
            "faults": " ".join(case.name for case in cases),
        },
    )
