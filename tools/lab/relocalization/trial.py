"""One kidnapping: the robot starts at an unknown place and drives until it is relocalized."""

from __future__ import annotations

import time
from collections import Counter
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
    Verdict,
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

    def true_pose(pose: SlamPose) -> FloatArray:
        return np.asarray(interpolate(truth.stamps_ns, truth.T_world_body, _within(truth, pose.stamp_ns))[0])

    def travel_m(pose: SlamPose) -> float:
        return float(truth.travelled_at_m(np.array([pose.stamp_ns]))[0])

    def errors(pose: SlamPose) -> tuple[float, float]:
        return deviation(known.to_world(pose.T_map_body), true_pose(pose))

    def local_errors(pose: SlamPose) -> tuple[float, float]:
        return deviation(known.to_world_nearby(pose.T_map_body, true_pose(pose)), true_pose(pose))

    def place(record: LoopClosureRecord) -> tuple[float, bool]:
        assert record.posterior_log_odds is not None
        assert record.T_reference_query is not None
        T_map_body = known.driven.graph.T_map_body[record.reference_keyframe_id] @ record.T_reference_query
        true = np.asarray(interpolate(truth.stamps_ns, truth.T_world_body, _within(truth, record.stamp_ns))[0])
        return record.posterior_log_odds, tolerance.allows(*deviation(known.to_world_nearby(T_map_body, true), true))

    best = max(tried.refusals, key=lambda each: each.score, default=None)
    error_m, error_deg = errors(fix) if fix else (None, None)
    local_error_m, local_error_deg = local_errors(fix) if fix else (None, None)
    return Outcome(
        number=drive.number,
        start_m=drive.start_m,
        is_along=drive.is_along,
        objects=drive.objects,
        verdict=judge(travel_m(fix), errors(fix), tolerance) if fix else Verdict.NOT_FOUND,
        distance_m=travel_m(fix) if fix else None,
        seconds=1e-9 * (fix.stamp_ns - tried.first_ns) if fix else None,
        error_m=error_m,
        error_deg=error_deg,
        local_error_m=local_error_m,
        local_error_deg=local_error_deg,
        is_misplaced=not tolerance.allows(*local_errors(fix)) if fix else None,
        later_right=tolerance.allows(*errors(tried.last)) if tried.last else None,
        refusals=dict(sorted(Counter(each.stage for each in tried.refusals).items())),
        best_refusal=f"{best.stage}: {best.reason}" if best else "",
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
    refusals: list[LoopClosureRecord]
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
    refusals, places = list[LoopClosureRecord](), list[LoopClosureRecord]()
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
            refusals += [each for each in candidates if not each.accepted]
            places += [each for each in candidates if each.posterior_log_odds is not None]
            if fix is not None:
                end_m = float(truth.travelled_at_m(np.array([fix.stamp_ns]))[0]) + HOLDS_FOR_M
    # The first search enters the whole map into the index of places before it begins.
    return _Trial(
        fix,
        last if slam.state != State.LOST else None,
        slam.first_stamp_ns,
        refusals,
        places,
        load_s + sum(query_s[:1]),
        tuple(1e3 * seconds for seconds in query_s[1:]),
    )


def _within(truth: PoseSeries, stamp_ns: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """A stamp (1,), or the nearest that the truth has."""
    return np.clip(np.array([stamp_ns], dtype=np.int64), truth.stamps_ns[0], truth.stamps_ns[-1])
