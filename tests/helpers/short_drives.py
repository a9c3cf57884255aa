"""Short drives for the tests of the estimator: simulated, altered by a test, replayed and read back."""

from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path

import numpy as np

from logs.importers.imported_log import TOPICS
from logs.messages import FactorGraphRecord, ObjectMapRecord, Odometry, Record, StatusRecord
from logs.reader import LogReader
from logs.selection import select_all
from logs.storage.stream import write_stream
from logs.topics import RawMessage
from logs.writer import LogWriter
from slam.common.config import Config
from slam.evaluation.evaluate import Evaluation, evaluate
from slam.evaluation.inputs.records import read_records
from slam.object_map.map_io import METADATA, SavedMap
from slam.replay import replay
from slam.simulation.config import OdometryConfig, SensorConfig, SimulationConfig
from slam.simulation.simulation import simulate
from slam.simulation.world import World
from slam.system import Slam

CLASSES = ("bench", "lamp", "tree", "vehicle")
Entry = tuple[str, int, Record]
"""Topic, log time, record."""

NO_DRIFT = OdometryConfig(scale_drift_percent=0.0, heading_drift_deg_per_100m=0.0)
EXACT_SENSOR = SensorConfig(
    noise_base_m=0.0,
    noise_per_m=0.0,
    dropout=0.0,
    false_positives_per_scan=0.0,
    misclassification=0.0,
    covariances=False,
)
EXACT = SimulationConfig(odometry=NO_DRIFT, sensor=EXACT_SENSOR)


def block_world() -> World:
    """A tour once around a square block, with about an object every 4 m, 4 m to 9 m off it."""
    rng, side_m, count = np.random.default_rng(7), 40.0, 40
    corners = np.array([[0.0, 0.0], [side_m, 0.0], [side_m, side_m], [0.0, side_m], [0.0, 0.0]])
    along = (np.arange(count) + rng.uniform(-0.3, 0.3, count)) * 4.0 * side_m / count % (4.0 * side_m)
    side = (along // side_m).astype(np.int64)
    direction = (corners[side + 1] - corners[side]) / side_m
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    offset = rng.uniform(4.0, 9.0, count) * rng.choice([-1.0, 1.0], count)
    xy = corners[side] + direction * (along - side * side_m)[:, None] + normal * offset[:, None]
    positions = np.concatenate([xy, rng.uniform(-0.5, 1.5, (count, 1))], axis=1)
    ids = tuple(f"object-{i}" for i in range(count))
    return World("block", ids, positions, tuple(rng.choice(CLASSES, count).tolist()), corners)


def drive(config: SimulationConfig = EXACT, *, seed: int = 1, world: World | None = None) -> list[Entry]:
    records = simulate(world or block_world(), config, seed=seed)
    return [(TOPICS[type(record)], record.stamp_ns, record) for record in records]


def odometry_of(entries: Iterable[Entry]) -> list[Odometry]:
    return [record for _, _, record in entries if isinstance(record, Odometry)]


def change(entries: Iterable[Entry], kind: type, alter: Callable[[int, Record], Record | None]) -> list[Entry]:
    """``entries`` with the i-th record of ``kind`` replaced by ``alter(i, record)``; None leaves it out."""
    changed: list[Entry] = []
    count = 0
    for topic, log_time_ns, record in entries:
        if isinstance(record, kind):
            altered = alter(count, record)
            count += 1
            if altered is not None:
                changed.append((topic, log_time_ns, altered))
        else:
            changed.append((topic, log_time_ns, record))
    return changed


def keep_until(entries: Iterable[Entry], seconds: float) -> list[Entry]:
    """The entries of the first ``seconds``, that time left out."""
    kept = list(entries)
    end_ns = kept[0][1] + round(seconds * 1e9)
    return [entry for entry in kept if entry[1] < end_ns]


def write_log(path: Path, entries: Iterable[tuple[str, int | None, Record]], **metadata: dict[str, str]) -> Path:
    """A log of records, each at its stamp where no log time is given, and of metadata by name."""
    with LogWriter(path) as writer:
        for name, values in metadata.items():
            writer.add_metadata(name, values)
        for topic, log_time_ns, record in entries:
            writer.write(topic, record, log_time_ns)
    return path


def write_records(path: Path, records: Iterable[tuple[str, Record]], **metadata: dict[str, str]) -> Path:
    """A log of records at their stamps."""
    return write_log(path, ((topic, None, record) for topic, record in records), **metadata)


def write_map(path: Path, objects: ObjectMapRecord, graph: FactorGraphRecord, *, twice: bool = False) -> Path:
    """A map file without any of the checks of ``save_map``."""
    with LogWriter(path) as writer:
        writer.add_metadata(METADATA, {"format_version": "1"})
        for _ in range(1 + twice):
            writer.write("/map/objects", objects, 0)
        writer.write("/map/graph", graph, 0)
    return path


def stream_of(entries: Iterable[Entry]) -> BytesIO:
    """Records as a stream of bytes, at its beginning."""
    stream = BytesIO()
    for topic, log_time_ns, record in entries:
        write_stream(stream, topic, record, log_time_ns)
    stream.seek(0)
    return stream


def raw_messages(path: Path, *topics: str) -> list[RawMessage]:
    """Of all topics unless some are named."""
    with LogReader(path) as reader:
        return list(reader.messages(topics or None))


def metadata_of(path: Path) -> dict[str, dict[str, str]]:
    with LogReader(path) as reader:
        return reader.metadata()


def records_of(path: Path, topic: str) -> list[Record]:
    with LogReader(path) as reader:
        selection = select_all(info for info in reader.topics() if info.topic == topic)
        return [entry.record for entry in reader.records(selection)]


def run(entries: Iterable[Entry], path: Path, config: Config | None = None) -> Evaluation:
    """Write, replay and measure a drive; ``path`` is the output, its input lies beside it."""
    replay(write_log(path.with_name("in.mcap"), entries), path, config or Config())
    return evaluate(read_records(path))


def final_status(path: Path) -> StatusRecord:
    status = records_of(path, "/slam/status")[-1]
    assert isinstance(status, StatusRecord)
    return status


def map_in_memory(entries: Iterable[Entry], *prior_map: SavedMap, extend: bool = True) -> Slam:
    """A system that has processed the records, not yet finished."""
    slam = Slam(Config(), *prior_map, extend=extend)
    for _, _, record in entries:
        slam.process(record)
    return slam
