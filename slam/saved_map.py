"""Maps that last: landmarks, keyframes and the factors between them, saved to a log and loaded from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.messages import FactorGraphRecord, ObjectMapRecord, SceneMarkers
from logs.reader import LogReader
from logs.selection import Selection
from logs.topics import RecordKind
from logs.writer import LogWriter
from slam.errors import SavedMapError

FORMAT_VERSION = "1"
METADATA = "dslam_map"
OBJECTS_TOPIC, GRAPH_TOPIC, MARKERS_TOPIC = "/map/objects", "/map/graph", "/map/landmarks"
GRAVITY = "z of the frame map points up"


@dataclass(frozen=True, slots=True, eq=False)
class SavedMap:
    """What a drive left behind for the next one: confirmed landmarks, and the graph that holds them together.

    Descriptors are not kept: to compute them again takes less time than to read them would save, and so a map serves
    whatever descriptor is configured.
    """

    objects: ObjectMapRecord
    graph: FactorGraphRecord


def save_map(
    path: Path, objects: ObjectMapRecord, graph: FactorGraphRecord, markers: SceneMarkers, provenance: dict[str, str]
) -> None:
    """Write a map log: NAME.part first, which is renamed when it is complete.

    Args:
        path: replaced if it is there.
        objects: all landmarks; only confirmed ones are kept.
        graph: the optimised graph.
        markers: the landmarks for viewers.
        provenance: version, configuration and input of the drive.

    Raises:
        LogError: it cannot be written.
    """
    with LogWriter(path) as writer:
        writer.add_metadata(METADATA, {"format_version": FORMAT_VERSION, "gravity": GRAVITY, **provenance})
        writer.write(OBJECTS_TOPIC, confirmed(objects), objects.stamp_ns)
        writer.write(GRAPH_TOPIC, graph, objects.stamp_ns)
        writer.write(MARKERS_TOPIC, markers, objects.stamp_ns)


def load_map(path: Path) -> SavedMap:
    """Read a map log.

    Raises:
        LogError: no MCAP file.
        SavedMapError: a log that is no map, of another format version, damaged, or empty.
    """
    with LogReader(path) as reader:
        metadata = reader.metadata().get(METADATA)
        if metadata is None:
            raise SavedMapError(f"{path} is a log, but no map; make one by 'dslam replay LOG --save-map MAP.mcap'")
        version = metadata.get("format_version")
        if version != FORMAT_VERSION:
            raise SavedMapError(
                f"{path} is a map of format version {version}, this program reads {FORMAT_VERSION}; make it again by "
                "'dslam replay LOG --save-map MAP.mcap'"
            )
        if metadata.get("gravity") != GRAVITY:
            raise SavedMapError(
                f"{path} does not say which way is up in it; make it again by 'dslam replay --save-map'"
            )
        wanted = Selection({OBJECTS_TOPIC: (RecordKind.OBJECT_MAP,), GRAPH_TOPIC: (RecordKind.FACTOR_GRAPH,)})
        try:
            records = [entry.record for entry in reader.records(wanted)]
        except LogError as error:
            raise SavedMapError(f"{path} cannot be used as a map: {error}") from error
        if reader.counters:
            raise SavedMapError(f"{path} is damaged ({_listed(reader.counters)}); half a map is none, make it again")
    objects = [record for record in records if isinstance(record, ObjectMapRecord)]
    graphs = [record for record in records if isinstance(record, FactorGraphRecord)]
    if len(objects) != 1 or len(graphs) != 1:
        raise SavedMapError(f"{path} holds {len(objects)} object maps and {len(graphs)} graphs; a map has one of each")
    if not objects[0].ids or not len(graphs[0].keyframe_ids):
        raise SavedMapError(f"{path} is a map without landmarks or keyframes; nothing can be found in it")
    unknown = set(graphs[0].observation_landmark_ids) - set(objects[0].ids)
    if unknown:
        raise SavedMapError(f"{path}: its graph observes landmark {min(unknown)}, which it does not have")
    return SavedMap(objects[0], graphs[0])


def confirmed(objects: ObjectMapRecord) -> ObjectMapRecord:
    """The same map without its tentative and retired landmarks."""
    rows = np.flatnonzero([state == "confirmed" for state in objects.states])
    return ObjectMapRecord(
        stamp_ns=objects.stamp_ns,
        frame_id=objects.frame_id,
        vocabulary=objects.vocabulary,
        ids=tuple(objects.ids[row] for row in rows),
        positions=objects.positions[rows],
        covariances=objects.covariances[rows],
        class_probabilities=objects.class_probabilities[rows],
        states=tuple(objects.states[row] for row in rows),
        reasons=tuple(objects.reasons[row] for row in rows),
        observation_counts=objects.observation_counts[rows],
        first_seen_ns=objects.first_seen_ns[rows],
        last_seen_ns=objects.last_seen_ns[rows],
    )


def _listed(counters: dict[str, int]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in counters.items())
