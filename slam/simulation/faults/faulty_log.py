"""A log with faults: read, changed, and written as another log."""

from __future__ import annotations

import heapq
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from logs.errors import LogError, UnwritableLogError
from logs.messages import ObjectDetections
from logs.reader import LogReader
from logs.selection import Selection, select_topics
from logs.topics import RawMessage, RecordKind
from logs.writer import LogWriter, partial_path
from slam.common.errors import SimulationError, SlamError
from slam.simulation.faults.fault import FaultCase
from slam.simulation.faults.stream import Entry

_NEEDED = (RecordKind.ODOMETRY, RecordKind.DETECTIONS)
_READING = 0.5  # part of the progress


@dataclass(frozen=True, slots=True)
class FaultSummary:
    """Messages of the output by topic, detections in the input and in the output, and what was left out, by reason."""

    message_counts: dict[str, int]
    detections_before: int
    detections: int
    left_out: dict[str, int]


def apply_faults(stream: Sequence[Entry], cases: Sequence[FaultCase], *, seed: int) -> list[Entry]:
    """The messages with the faults, one after the other.

    Args:
        stream: all messages of a log, which is not changed.
        cases: what to do. Random numbers are those of the seed, of the name of the fault, and of how often it came
            before; they do not depend on other faults.
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
            result = case.fault.function(result, *case.values, **({"rng": rng} if case.fault.is_random else {}))
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

    The topics that a fault reads are held in memory. Topics that no fault changes are copied as they are, but that
    several transforms of one message become messages of their own where a fault reads them.

    Args:
        source: a log with odometry and detections.
        output: replaced if it is there; written as NAME.part and renamed when finished.
        cases: what to do, in this order; those that change nothing are passed over.
        seed: the same seed, faults and input give the same bytes.
        topics: kind -> topic, where the log leaves a choice.
        progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the input cannot be read or the output cannot be written.
        SimulationError: the log has not what a fault needs, or the seed is negative.
    """
    cases = [case for case in cases if not case.is_neutral]
    with LogReader(source) as reader:
        for path in (output, partial_path(output)):
            if path.exists() and path.samefile(source):
                raise UnwritableLogError(f"writing {output} would overwrite the input {source}; give another output")
        selection = _selection(reader, cases, topics)
        stream = list(_read(reader, selection, progress))
        result = apply_faults(stream, cases, seed=seed)
        others = [info.topic for info in reader.topics() if info.topic not in selection.kinds]
        keeps_others = all(case.fault.keeps_others for case in cases)
        copied = _copied(reader, others if keeps_others else ())
        written: Counter[str] = Counter()
        with LogWriter(output, refusals=(LogError, SlamError)) as writer:
            _write_metadata(reader, writer, cases, seed)
            rewritten = {entry.topic for entry in result if entry.raw is None}
            for entry in heapq.merge(result, copied, key=lambda entry: (entry.log_time_ns, entry.number)):
                if isinstance(entry.content, RawMessage):
                    writer.write_raw(entry.content)
                elif entry.raw is not None and entry.topic not in rewritten:
                    writer.write_raw(entry.raw)
                else:
                    writer.write(entry.topic, entry.content, entry.log_time_ns)
                written[entry.topic] += 1
                if progress is not None:
                    progress(_READING + (1.0 - _READING) * min(written.total() / max(len(result), 1), 1.0))
        left_out = Counter(reader.counters)
        if not keeps_others:
            left_out["irreversible_messages"] += sum(i.message_count for i in reader.topics() if i.topic in others)
    return FaultSummary(
        dict(sorted(written.items())),
        _detection_count(stream),
        _detection_count(result),
        dict(sorted((+left_out).items())),
    )


def _detection_count(stream: Sequence[Entry]) -> int:
    return sum(len(entry.content.labels) for entry in stream if isinstance(entry.content, ObjectDetections))


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
    kept = {topic: kinds for topic, kinds in selection.kinds.items() if used & set(kinds)}
    return Selection(kept, selection.mappings)


def _read(reader: LogReader, selection: Selection, progress: Callable[[float], None] | None) -> Iterator[Entry]:
    """The messages of the selected topics; one that gives no record is kept raw."""
    topics = {info.topic for info in reader.topics()}
    total = max(sum(info.message_count for info in reader.topics()), 1)
    items = reader.items(selection, copy=list(selection.kinds), times_of=topics - set(selection.kinds))
    for number, item in enumerate(items):
        raw = item.raw
        if progress is not None:
            progress(min(_READING * number / total, _READING))
        if raw.topic not in selection.kinds:
            continue
        if not item.records:
            yield Entry(raw.topic, raw.log_time_ns, raw, number=number)
        elif len(item.records) == 1:
            yield Entry(raw.topic, raw.log_time_ns, item.records[0], raw, number)
        else:  # several transforms in one message
            yield from (Entry(raw.topic, raw.log_time_ns, record, number=number) for record in item.records)


def _copied(reader: LogReader, topics: Collection[str]) -> Iterator[Entry]:
    """The messages of the topics that no fault reads."""
    for number, raw in enumerate(reader.messages() if topics else ()):
        if raw.topic in topics:
            yield Entry(raw.topic, raw.log_time_ns, raw, number=number)


def _write_metadata(reader: LogReader, writer: LogWriter, cases: Sequence[FaultCase], seed: int) -> None:
    """The metadata of the input, and how this log was made from it; later faults hide no earlier ones."""
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
