"""One kidnapping: the robot starts at an unknown place and drives until it is relocalized."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from logs.messages import GroundTruthPose, LoopClosureRecord, ObjectDetections, Odometry, Record, SlamPose
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import interpolate
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.localization.state import State
from slam.object_map.map_io import SavedMap
from slam.system import Slam
from tools.lab.relocalization.figures import (
    HOLDS_FOR_M,
    Outcome,
    Tolerance,
    deviation,
    judge,
)
from tools.lab.relocalization.known_map import KnownMap, truth_of


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Measurements from the start of the search on, and the truth, in the order of a log.

    ``start_m`` along the whole tour; ``is_along``: in the direction of the drive that made the map; ``objects``: in
    reach at the start.
    """

    number: int
    start_m: float
    is_along: bool
    objects: int
    records: tuple[Record, ...]


def put_down(known: KnownMap, drive: Drive, config: Config, tolerance: Tolerance) -> Outcome:
    """Drive until the robot believes to know where it is, and 10 m more."""
    truth = truth_of(drive.records)
    tried = _drive(known, drive.records, truth, config)
    fix = tried.fix

    def errors(T_map_body: FloatArray, stamp_ns: int, *, nearby: bool = False) -> tuple[float, float]:
        within_ns = np.clip(np.array([stamp_ns], dtype=np.int64), truth.stamps_ns[0], truth.stamps_ns[-1])
        T_world_body = np.asarray(interpolate(truth.stamps_ns, truth.T_world_body, within_ns)[0])
        found = known.to_world_nearby(T_map_body, T_world_body) if nearby else known.to_world(T_map_body)
        return deviation(found, T_world_body)

    def place(record: LoopClosureRecord) -> tuple[float, bool]:
        assert record.posterior_log_odds is not None
        assert record.T_reference_query is not None
        T_map_body = known.driven.graph.T_map_body[record.reference_keyframe_id] @ record.T_reference_query
        return record.posterior_log_odds, tolerance.allows(*errors(T_map_body, record.stamp_ns, nearby=True))

    distance_m = float(truth.travelled_at_m(np.array([fix.stamp_ns]))[0]) if fix else None
    error = errors(fix.T_map_body, fix.stamp_ns) if fix else (None, None)
    local_error = errors(fix.T_map_body, fix.stamp_ns, nearby=True) if fix else (None, None)
    return Outcome(
        number=drive.number,
        start_m=drive.start_m,
        is_along=drive.is_along,
        objects=drive.objects,
        verdict=judge(distance_m, error, tolerance),
        distance_m=distance_m,
        seconds=1e-9 * (fix.stamp_ns - tried.first_ns) if fix else None,
        error_m=error[0],
        error_deg=error[1],
        local_error_m=local_error[0],
        local_error_deg=local_error[1],
        is_misplaced=not tolerance.allows(*local_error) if fix else None,
        later_right=tolerance.allows(*errors(tried.last.T_map_body, tried.last.stamp_ns)) if tried.last else None,
        load_s=tried.load_s,
        query_ms=tried.query_ms,
        places=tuple(place(each) for each in tried.places) if isinstance(known.saved, SavedMap) else (),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """``fix``: the first pose in the map; ``last``: the one at the end; None if the robot is lost. ``places``: the
    likeliest of each search until the fix.
    """

    fix: SlamPose | None
    last: SlamPose | None
    first_ns: int
    places: list[LoopClosureRecord]
    load_s: float
    query_ms: tuple[float, ...]


def _drive(known: KnownMap, records: Iterable[Record], truth: PoseSeries, config: Config) -> _Trial:
    """Search for the place of a drive."""
    started = time.perf_counter()
    slam = Slam(config, known.saved, extend=False)
    load_s = time.perf_counter() - started
    fix: SlamPose | None = None
    last: SlamPose | None = None
    end_m = np.inf
    places = list[LoopClosureRecord]()
    query_s: list[float] = []
    for record in records:
        if isinstance(record, GroundTruthPose):
            continue
        measured = isinstance(record, Odometry | ObjectDetections)
        if measured and end_m < np.inf and truth.travelled_at_m(np.array([record.stamp_ns]))[0] > end_m:
            break
        updates = slam.process(record)
        last = next((each for each in reversed(updates) if isinstance(each, SlamPose)), last)
        if fix is None:
            fix = last
            query_s = list(slam.closing_seconds)
            candidates = [each for each in updates if isinstance(each, LoopClosureRecord)]
            places += [each for each in candidates if each.posterior_log_odds is not None]
            if fix is not None:
                end_m = float(truth.travelled_at_m(np.array([fix.stamp_ns]))[0]) + HOLDS_FOR_M
    # The first search enters the whole map into the index of places before it begins.
    return _Trial(
        fix,
        last if slam.state != State.LOST else None,
        slam.first_stamp_ns,
        places,
        load_s + sum(query_s[:1]),
        tuple(1e3 * seconds for seconds in query_s[1:]),
    )
