"""Saved maps: landmarks, keyframes and the factors between them, written to a log and read from it."""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path

import numpy as np
from pydantic_core import from_json

from logs.container.limits import RESULT_LIMITS
from logs.dslam_codec import take_rows
from logs.errors import LogError
from logs.messages import FactorGraphRecord, ObjectMapRecord, SceneMarkers, ScenePoints
from logs.reader import LogReader
from logs.records import frozen
from logs.scene import class_colors
from logs.selection import Selection
from logs.storage.regular_file import AnyPath
from logs.topics import RecordKind
from logs.writer import LogWriter
from slam.backend.edge_kind import EdgeKind
from slam.common.arrays import BoolArray, FloatArray
from slam.common.errors import SavedMapError, SlamError
from slam.common.georeference import Georeference
from slam.object_map.map_validation import find_fault, parts

logger = logging.getLogger(__name__)

FORMAT_VERSION = "1"
METADATA = "dslam_map"
OBJECTS_TOPIC, GRAPH_TOPIC, MARKERS_TOPIC = "/map/objects", "/map/graph", "/map/landmarks"
POINTS_TOPIC = "/map/landmark_points"
IMPORTED = "imported"
"""``kind`` in the metadata of a map without a trajectory."""
MAKE_IT = "make it again by 'dslam replay LOG -o OUT.mcap --save-map MAP.mcap'"


@frozen
class SavedMap:
    """The map of a drive for the next one: confirmed landmarks, and the graph that connects them.

    Descriptors are not kept: computing them takes less time than reading them, and a map serves any configured
    descriptor. ``metadata``: format of the file and provenance of the last drive; ``drives``:
    ``input_sha256`` and ``version`` of each drive that went into the map, the first one first.
    """

    objects: ObjectMapRecord
    graph: FactorGraphRecord
    metadata: Mapping[str, str] = field(default_factory=dict)
    drives: tuple[Mapping[str, str], ...] = ()

    @property
    def georeference(self) -> Georeference | None:
        """Georeference of the map, if it is known.

        Raises:
            GeometryError: the metadata have an invalid one.
        """
        text = self.metadata.get("georeference")
        return None if text is None else Georeference.from_json(text)

    @property
    def vocabulary(self) -> tuple[str, ...]:
        """The classes of its landmarks, sorted."""
        return tuple(sorted(set(self.objects.labels)))

    @property
    def positions(self) -> FloatArray:
        """Positions (N, 3) m of its landmarks."""
        return self.objects.positions


def save_map(
    path: Path,
    objects: ObjectMapRecord,
    graph: FactorGraphRecord,
    provenance: Mapping[str, str],
    *,
    earlier_drives: Sequence[Mapping[str, str]] | None = None,
) -> None:
    """Write a map log: NAME.part first, which is renamed when it is complete.

    Args:
        path: replaced if it is there.
        objects: all landmarks; only confirmed ones are kept.
        graph: the optimised graph. Condensed keyframes are left out, and a stretch that only a break of the odometry
            ties to the rest, which lies anywhere, with what only it saw.
        provenance: version, configuration and input of the drive.
        earlier_drives: those of the map that the drive extended.

    Raises:
        LogError: it cannot be written.
        SavedMapError: what is to be saved would be refused when it is loaded.
    """
    kept = confirmed(objects)
    graph = observing(graph, kept, ~_condensed(graph))
    _refuse_fault(path, kept, graph)
    is_tied = _tied(graph, to_first=earlier_drives is not None)
    seen = set(graph.observation_landmark_ids)
    graph = observing(graph, kept, is_tied)
    adrift = seen - set(graph.observation_landmark_ids)
    kept = of_rows(kept, np.array([landmark not in adrift for landmark in kept.ids]))
    _refuse_fault(path, kept, graph)
    if not is_tied.all():
        logger.warning(
            "%d keyframes and %d landmarks are not in the map: only a break of the odometry connects them to the rest",
            np.count_nonzero(~is_tied),
            len(adrift),
        )
    drives = [*(earlier_drives or ()), drive_of(provenance)]
    about = {**provenance, "format_version": FORMAT_VERSION, "drives": json.dumps(drives)}
    with LogWriter(path, refusals=(LogError, SlamError)) as writer:
        writer.add_metadata(METADATA, about)
        writer.write(OBJECTS_TOPIC, kept, objects.stamp_ns)
        writer.write(GRAPH_TOPIC, graph, objects.stamp_ns)
        writer.write(MARKERS_TOPIC, make_markers(kept))
        points = ScenePoints(kept.stamp_ns, kept.frame_id, kept.positions, class_colors(kept.classes))
        writer.write(POINTS_TOPIC, points)


def make_markers(objects: ObjectMapRecord) -> SceneMarkers:
    """The confirmed landmarks for viewers."""
    kept = confirmed(objects)
    return SceneMarkers(kept.stamp_ns, kept.frame_id, kept.positions, kept.vocabulary, kept.classes, kept.ids)


def write_map(path: Path, saved: SavedMap) -> None:
    """Write a map that was made of saved ones; its metadata say what its last drive was.

    Raises:
        LogError: it cannot be written.
        SavedMapError: it would be refused when it is loaded.
    """
    save_map(path, saved.objects, saved.graph, saved.metadata, earlier_drives=saved.drives[:-1])


def _refuse_fault(path: Path, objects: ObjectMapRecord, graph: FactorGraphRecord) -> None:
    fault = find_fault(objects, graph)
    if fault:
        raise SavedMapError(f"{path} was not written, because it could not be used: {fault}")


def load_map(path: AnyPath) -> SavedMap:
    """Read a map log.

    Raises:
        LogError: no MCAP file.
        SavedMapError: a log that is no map, of another format version, damaged, empty, or inconsistent.
    """
    with LogReader(path, RESULT_LIMITS) as reader:
        metadata = reader.metadata().get(METADATA)
        if metadata is None:
            _refuse_damage(path, reader.counters)
            raise SavedMapError(
                f"{path} is a log, but no map; make one by 'dslam replay LOG -o OUT.mcap --save-map MAP.mcap'"
            )
        version = metadata.get("format_version")
        if version != FORMAT_VERSION:
            raise SavedMapError(
                f"{path} is a map of format version {version}, this program reads {FORMAT_VERSION}; {MAKE_IT}"
            )
        wanted = Selection({OBJECTS_TOPIC: (RecordKind.OBJECT_MAP,), GRAPH_TOPIC: (RecordKind.FACTOR_GRAPH,)})
        try:
            records = [entry.record for entry in reader.records(wanted)]
        except LogError as error:
            raise SavedMapError(f"{path} cannot be used as a map: {error}") from error
        _refuse_damage(path, reader.counters)
    objects = [record for record in records if isinstance(record, ObjectMapRecord)]
    graphs = [record for record in records if isinstance(record, FactorGraphRecord)]
    if len(objects) != 1 or len(graphs) != 1:
        raise SavedMapError(
            f"{path} holds {len(objects)} object maps and {len(graphs)} graphs, a map has one of each; {MAKE_IT}"
        )
    fault = find_fault(objects[0], graphs[0])
    if fault:
        raise SavedMapError(f"{path} cannot be used as a map: {fault}; {MAKE_IT}")
    return SavedMap(objects[0], graphs[0], dict(metadata), _drives(path, metadata))


def are_of_kind(graph: FactorGraphRecord, kind: EdgeKind) -> BoolArray:
    """Whether each edge (E,) is of that kind."""
    return np.array([each == kind for each in graph.edge_kinds], dtype=np.bool_)


def confirmed(objects: ObjectMapRecord) -> ObjectMapRecord:
    """The same map without its tentative and retired landmarks."""
    return of_rows(objects, objects.is_confirmed)


def of_rows(objects: ObjectMapRecord, kept: BoolArray) -> ObjectMapRecord:
    """Of the landmarks those that are ``kept`` (N,)."""
    # Merged landmarks are retired, and not in a map.
    return replace(take_rows(objects, N=np.flatnonzero(kept)), merged_into=())


def observing(graph: FactorGraphRecord, objects: ObjectMapRecord, kept: BoolArray) -> FactorGraphRecord:
    """The graph of the keyframes that are ``kept`` (K,), with what they observed of these landmarks.

    Edges to keyframes that are not kept are left out, and covariances of poses, which no drive needs.
    """
    keyframes, landmarks = graph.keyframe_ids[kept], set(objects.ids)
    of_landmarks = np.array([landmark in landmarks for landmark in graph.observation_landmark_ids], dtype=np.bool_)
    part = take_rows(
        graph,
        K=np.flatnonzero(kept),
        E=np.flatnonzero(np.isin(graph.edge_keyframe_ids, keyframes).all(axis=1)),
        O=np.flatnonzero(of_landmarks & np.isin(graph.observation_keyframe_ids, keyframes)),
    )
    return replace(part, pose_covariances=np.zeros((0, 6, 6)))


def _condensed(graph: FactorGraphRecord) -> BoolArray:
    """Which keyframes (K,) only condensed edges connect to the rest: other keyframes represent them."""
    is_condensed = are_of_kind(graph, EdgeKind.CONDENSED)
    tied, otherwise = graph.edge_keyframe_ids[is_condensed], graph.edge_keyframe_ids[~is_condensed]
    needed = np.concatenate([otherwise.ravel(), graph.observation_keyframe_ids])
    return np.isin(graph.keyframe_ids, tied) & ~np.isin(graph.keyframe_ids, needed)


def _tied(graph: FactorGraphRecord, *, to_first: bool) -> BoolArray:
    """Which keyframes (K,) more than a break of the odometry ties to the first one, or else to most others."""
    is_break = are_of_kind(graph, EdgeKind.DISCONTINUITY)
    part = parts(graph.keyframe_ids, graph.edge_keyframe_ids[~is_break])
    return part == (part[0] if to_first else np.bincount(part).argmax())


def _drives(path: AnyPath, metadata: Mapping[str, str]) -> tuple[Mapping[str, str], ...]:
    try:
        drives = from_json(metadata.get("drives", "[]"))
        return tuple(drive_of(drive) for drive in drives) or (drive_of(metadata),)
    except (ValueError, TypeError, AttributeError) as error:
        raise SavedMapError(f"{path} is damaged (its list of drives cannot be read: {error}); {MAKE_IT}") from error


def drive_of(provenance: Mapping[str, str]) -> dict[str, str]:
    """The input of a drive and the version that mapped it."""
    return {key: provenance.get(key, "") for key in ("input_sha256", "version")}


def _refuse_damage(path: AnyPath, counters: Mapping[str, int]) -> None:
    if counters:
        listed = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in counters.items())
        raise SavedMapError(f"{path} is damaged ({listed}); the map is incomplete, {MAKE_IT}")
