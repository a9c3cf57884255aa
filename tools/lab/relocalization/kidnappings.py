"""Time to relocalization in a map, at places of a drive with truth.

``benchmark_relocalization`` is where to begin reading.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from logs.container.limits import RESULT_LIMITS
from logs.messages import GroundTruthPose, ObjectDetections, Odometry, Record, Transform
from logs.reader import LogReader
from logs.selection import select_topics
from logs.topics import RecordKind
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.object_map.map_io import SavedMap
from slam.place_recognition.imported_map import ImportedMap
from slam.prepared_log import calibrate_logs
from tools.lab.relocalization.figures import sum_up
from tools.lab.relocalization.known_map import KnownMap, known_imported, map_drive, truth_of
from tools.lab.relocalization.trial import RECOVERED_WITHIN_M, Drive, put_down

_KINDS = (RecordKind.ODOMETRY, RecordKind.DETECTIONS, RecordKind.GROUND_TRUTH)
_Kept = Odometry | ObjectDetections | GroundTruthPose | Transform


def benchmark_relocalization(
    path: Path,
    config: Config,
    *,
    given: ImportedMap | float,
    kidnaps: int,
    max_travel_m: float = 60.0,
    protocol: Protocol | None = None,
    topics: Mapping[str, str] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Relocalize at places of a drive with truth, evenly spread over it.

    The figures are of places in the map. At places far from it (``elsewhere_...``) any fix is false.

    Args:
        path: the log.
        config: of the estimator; what it leaves open is estimated from the log.
        given: an imported map in the frame of the truth; or seconds from the beginning of the log, up to which it is
            mapped, and from which on places are taken.
        kidnaps: most places in the map, and most places far from it.
        max_travel_m: length of each search.
        protocol: the tolerance of a right fix.
        topics: kind -> topic, where the log leaves a choice.
        on_progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the log cannot be read.
        SlamError: it holds no truth, or no place of it is in the map.
    """
    protocol = protocol or Protocol()
    records = _read(path, topics)
    truth = truth_of(records)
    if not len(truth):
        raise EvaluationError(f"{path} holds no ground truth, so no place in it is known; see --topic ground_truth=")
    if config.calibrate:
        config = calibrate_logs([path], config, topics=topics).config
    begin_ns = int(truth.stamps_ns[0])
    with threadpool_limits(1):
        if isinstance(given, ImportedMap):
            known, reach_m = known_imported(given), config.sensor_range_m
        else:
            begin_ns += round(1e9 * given)
            known, reach_m = map_drive(_between(records, 0, begin_ns), config), protocol.revisit_distance_m
        inside, outside = find_starts(known, truth, begin_ns, reach_m, 2.0 * config.sensor_range_m, max_travel_m)
        if not len(inside):
            raise EvaluationError(
                f"after {(begin_ns - truth.stamps_ns[0]) * 1e-9:g} s the drive never stays within {reach_m:g} m of the "
                f"map for {RECOVERED_WITHIN_M:g} m; choose another time or map"
            )
        inside, outside = _spread(inside, kidnaps), _spread(outside, kidnaps)
        outcomes = list[dict[str, Any]]()
        for row in (*inside, *outside):
            drive = _drive(known, records, truth, int(row), max_travel_m)
            outcomes.append(put_down(known, drive, config, protocol))
            if on_progress is not None:
                on_progress(len(outcomes) / (len(inside) + len(outside)))
    elsewhere = outcomes[len(inside) :]
    return sum_up(
        outcomes[: len(inside)],
        drive=path.stem,
        landmarks=known.landmark_count,
        map_ate_m=known.ate_m,
        elsewhere_kidnaps=len(elsewhere),
        elsewhere_fixes=sum(each["distance_m"] is not None for each in elsewhere),
        elsewhere_outcomes=elsewhere,
    )


def find_starts(
    known: KnownMap, truth: PoseSeries, begin_ns: int, reach_m: float, far_m: float, max_travel_m: float
) -> tuple[IntArray, IntArray]:
    """Rows of the truth at which drives can begin: where the map is in reach up to a fix, and where it never is."""
    travelled_m = truth.travelled_m
    apart_m = np.asarray(cKDTree(known.positions[:, :2]).query(truth.positions[:, :2])[0])
    begins = np.unique(np.searchsorted(travelled_m, np.arange(0.0, travelled_m[-1], Protocol().query_spacing_m)))
    begins = begins[truth.stamps_ns[begins] >= begin_ns]

    def starts(length_m: float, is_start: Callable[[FloatArray], bool]) -> IntArray:
        rows = begins[travelled_m[begins] + length_m <= travelled_m[-1]]
        ends = np.searchsorted(travelled_m, travelled_m[rows] + length_m) + 1
        return np.array([row for row, end in zip(rows, ends, strict=True) if is_start(apart_m[row:end])], np.int64)

    return (
        starts(RECOVERED_WITHIN_M, lambda stretch_m: bool(np.all(stretch_m <= reach_m))),
        starts(max_travel_m, lambda stretch_m: bool(np.all(stretch_m > far_m))),
    )


def _read(path: Path, topics: Mapping[str, str] | None) -> list[Record]:
    with LogReader(path, RESULT_LIMITS) as reader:
        selection = select_topics(reader.topics(), topics, needed=_KINDS)
        return [entry.record for entry in reader.records(selection) if isinstance(entry.record, _Kept)]


def _between(records: list[Record], first_ns: int, last_ns: int) -> list[Record]:
    """The records of a time, and all transforms."""
    return [each for each in records if isinstance(each, Transform) or first_ns <= each.stamp_ns <= last_ns]


def _spread(rows: IntArray, count: int) -> IntArray:
    """At most ``count`` of the rows (R,), evenly."""
    chosen = np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(np.int64)
    return np.unique(rows[chosen])


def _drive(known: KnownMap, records: list[Record], truth: PoseSeries, row: int, max_travel_m: float) -> Drive:
    travelled_m, T_world_body = truth.travelled_m, truth.T_world_body[row]
    last = min(int(np.searchsorted(travelled_m, travelled_m[row] + max_travel_m)), len(travelled_m) - 1)
    perceived = _between(records, int(truth.stamps_ns[row]), int(truth.stamps_ns[last]))
    mapped_forward = known.T_world_body_gt[known.nearest(T_world_body), :2, 0]
    is_along = bool(mapped_forward @ T_world_body[:2, 0] >= 0.0) if isinstance(known.saved, SavedMap) else None
    objects = next((len(each.labels) for each in perceived if isinstance(each, ObjectDetections)), 0)
    return Drive(row, float(travelled_m[row]), is_along, objects, tuple(perceived))
