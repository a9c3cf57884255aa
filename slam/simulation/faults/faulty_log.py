"""A log with faults: read, changed, and written as another log."""

import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.messages import Record
from logs.reader import LogReader
from logs.records import frozen
from logs.selection import Selection, select_topics
from logs.topics import RecordKind
from logs.writer import LogWriter
from slam.common.errors import SimulationError, SlamError
from slam.simulation.faults.recording import Message, Recording, make_recording
from slam.simulation.faults.registry import Fault

_NEEDED = (RecordKind.ODOMETRY, RecordKind.DETECTIONS)
_READ = (*_NEEDED, RecordKind.DETECTION_TRUTH, RecordKind.TRANSFORMS, RecordKind.GROUND_TRUTH, RecordKind.OBJECT_TRUTH)


@frozen
class FaultSummary:
    """Detections in the input and in the output, messages of the output by topic, and what was left out, by reason."""

    detections_before: int
    detections: int
    message_counts: dict[str, int]
    left_out: dict[str, int]


def apply_faults(log: Recording, faults: Sequence[Fault], *, seed: int) -> None:
    """Change the recording by the faults, one after the other.

    Args:
        log: what to change.
        faults: what to do. Random numbers are those of the seed, of the name of the fault, and of how often it came
            before; they do not depend on other faults.
        seed: 0 or more.

    Raises:
        SimulationError: the log has not what a fault needs.
    """
    times: Counter[str] = Counter()
    for fault in faults:
        name = fault.function.__name__
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), times[name]])
        times[name] += 1
        try:
            fault.apply(log, rng)
        except SimulationError as error:
            raise SimulationError(f"fault {fault.name}: {error}") from error


def write_faulty(
    source: Path,
    output: Path,
    faults: Sequence[Fault],
    *,
    seed: int,
    topics: Mapping[str, str] | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> FaultSummary:
    """Write the log ``source`` with faults as the log ``output``, with the metadata "faults".

    What faults can read is held in memory. Topics that no fault changes are copied as they are.

    Args:
        source: a log with odometry and detections.
        output: replaced if it is there; written as NAME.part and renamed when finished.
        faults: what to do, in this order.
        seed: the same seed, faults and input give the same bytes.
        topics: kind -> topic, where the log leaves a choice.
        progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the input cannot be read or the output cannot be written.
        SimulationError: the log has not what a fault needs.
    """
    with LogReader(source) as reader:
        selection = select_topics(reader.topics(), topics, needed=_NEEDED)
        log = make_recording(_read(reader, selection))
        left_out = reader.counters
        before, detections_before = Counter(log.messages), _detection_count(log)
        apply_faults(log, faults, seed=seed)
        rewritten = _changed_topics(before, Counter(log.messages), selection)
        changed = defaultdict[int, list[Message[Record]]](list)
        for message in log.messages:
            if message.topic in rewritten:
                changed[message.number].append(message)
        written, total = Counter[str](), max(sum(info.message_count for info in reader.topics()), 1)
        with LogWriter(output, refusals=(LogError, SlamError)) as writer:
            _write_metadata(reader, writer, faults, seed)
            for number, raw in enumerate(reader.messages()):
                if raw.topic not in rewritten:
                    writer.write_raw(raw)
                    written[raw.topic] += 1
                for message in changed[number]:
                    writer.write(message.topic, message.record, message.log_time_ns)
                    written[message.topic] += 1
                progress(min((number + 1) / total, 1.0))
    return FaultSummary(detections_before, _detection_count(log), dict(sorted(written.items())), left_out)


def _read(reader: LogReader, selection: Selection) -> Iterator[Message[Record]]:
    """The messages of the kinds that faults can read, numbered among all of the log."""
    kept = {topic: kinds for topic, kinds in selection.kinds.items() if set(kinds) & set(_READ)}
    others = {info.topic for info in reader.topics()} - kept.keys()
    for number, item in enumerate(reader.items(Selection(kept, selection.mappings), copy=others)):
        yield from (Message(item.raw.topic, item.raw.log_time_ns, record, number) for record in item.records)


def _changed_topics(old: Counter[Message[Record]], new: Counter[Message[Record]], selection: Selection) -> set[str]:
    """The topics of which a message is new, or gone.

    Raises:
        SimulationError: one of them plays several parts, as frames that are the odometry do.
    """
    changed = {message.topic for message in (old - new) + (new - old)}
    for topic in sorted(changed):
        kinds = selection.kinds[topic]
        if len(kinds) > 1:
            raise SimulationError(
                f"{topic} is {' and '.join(kinds)} in one and cannot be rewritten; record a topic for each"
            )
    return changed


def _detection_count(log: Recording) -> int:
    return sum(len(scan.seen.labels) for scan in log.scans)


def _write_metadata(reader: LogReader, writer: LogWriter, faults: Sequence[Fault], seed: int) -> None:
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
            "faults": " ".join(fault.name for fault in faults),
        },
    )
