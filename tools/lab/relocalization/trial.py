"""One kidnapping: the robot starts at an unknown place and drives until it is relocalized."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from logs.messages import GroundTruthPose, LoopClosureRecord, ObjectDetections, Odometry, Record, SlamPose
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import interpolate, invert, yaw_rad
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.localization.state import State
from slam.object_map.map_io import SavedMap
from slam.system import Slam
from tools.lab.relocalization.known_map import KnownMap, truth_of

RECOVERED_WITHIN_M = 40.0
"""Travel within which a right fix is a success."""
HOLDS_FOR_M = 10.0
"""Travel after which a fix is checked again."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A fix that is no farther from the truth, in the plane and in heading, is right."""

    metres: float
    degrees: float

    def allows(self, errors: tuple[float, float]) -> bool:
        """Whether a fix with these errors [m], [deg] is right."""
        return errors[0] <= self.metres and errors[1] <= self.degrees


class Verdict(StrEnum):
    """What became of a kidnapping: a right fix soon enough, a right one later, a wrong one, or none."""

    RECOVERED = "recovered"
    LATE = "late"
    WRONG = "wrong"
    NOT_FOUND = "not found"


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
    records: Sequence[Record]


def put_down(known: KnownMap, drive: Drive, config: Config, tolerance: Tolerance) -> dict[str, Any]:
    """Drive until the robot believes to know where it is, and 10 m more.

    Returns:
        ``number``, ``start_m``, ``is_along`` and ``objects`` of the drive, the ``verdict``, and of the first fix
        ``distance_m`` and ``seconds`` from the start, ``error_m`` and ``error_deg`` in the plane and in heading: None
        without a fix. ``local_error_m``, ``local_error_deg``: without the distortion of the map, which is taken at its
        word about where its own drive was nearby; by these the fix ``is_misplaced``, if they are too large.
        ``later_right``: whether the estimate is right 10 m after the fix, or at the end of the drive; None if the robot
        then knows that it is lost. ``load_s``: from the saved map to the end of the first search; ``query_ms``: each
        search after that until the fix. ``places``: of the likeliest place of each search, in a map with keyframes, its
        posterior log odds and whether it is right in the map.
    """
    truth = truth_of(drive.records)
    tried = _search(known, drive.records, truth, config)
    fix, last = tried.fix, tried.last

    def errors(T_map_body: FloatArray, stamp_ns: int, *, nearby: bool = False) -> tuple[float, float]:
        within_ns = np.clip(np.array([stamp_ns], dtype=np.int64), truth.stamps_ns[0], truth.stamps_ns[-1])
        T_world_body = np.asarray(interpolate(truth.stamps_ns, truth.T_world_body, within_ns)[0])
        found = known.to_world_nearby(T_map_body, T_world_body) if nearby else known.to_world(T_map_body)
        return deviation(found, T_world_body)

    def place(record: LoopClosureRecord) -> tuple[float, bool]:
        assert record.posterior_log_odds is not None
        assert record.T_reference_query is not None
        T_map_body = known.driven.graph.T_map_body[record.reference_keyframe_id] @ record.T_reference_query
        return record.posterior_log_odds, tolerance.allows(errors(T_map_body, record.stamp_ns, nearby=True))

    outcome: dict[str, Any] = {
        "number": drive.number,
        "start_m": drive.start_m,
        "is_along": drive.is_along,
        "objects": drive.objects,
        "verdict": Verdict.NOT_FOUND,
        **dict.fromkeys(("distance_m", "seconds", "error_m", "error_deg", "local_error_m", "local_error_deg")),
        "is_misplaced": None,
        "later_right": tolerance.allows(errors(last.T_map_body, last.stamp_ns)) if last else None,
        "load_s": tried.load_s,
        "query_ms": tried.query_ms,
        "places": [place(each) for each in tried.places] if isinstance(known.saved, SavedMap) else [],
    }
    if fix is not None:
        distance_m = float(truth.travelled_at_m(np.array([fix.stamp_ns]))[0])
        error, local_error = errors(fix.T_map_body, fix.stamp_ns), errors(fix.T_map_body, fix.stamp_ns, nearby=True)
        outcome |= {
            "verdict": judge(distance_m, error, tolerance),
            "distance_m": distance_m,
            "seconds": 1e-9 * (fix.stamp_ns - tried.first_ns),
            **dict(zip(("error_m", "error_deg"), error, strict=True)),
            **dict(zip(("local_error_m", "local_error_deg"), local_error, strict=True)),
            "is_misplaced": not tolerance.allows(local_error),
        }
    return outcome


def deviation(T_world_body_est: FloatArray, T_world_body_gt: FloatArray) -> tuple[float, float]:
    """Distance in the plane [m] and difference of heading [deg], both >= 0, of two poses (4, 4)."""
    offset = T_world_body_est[:2, 3] - T_world_body_gt[:2, 3]
    turn_rad = float(yaw_rad(invert(T_world_body_gt) @ T_world_body_est))
    return float(np.hypot(*offset)), abs(float(np.rad2deg(turn_rad)))


def judge(distance_m: float, errors: tuple[float, float], tolerance: Tolerance) -> Verdict:
    """The verdict on a fix after so much travel, with errors in metres and degrees."""
    if not tolerance.allows(errors):
        return Verdict.WRONG
    return Verdict.RECOVERED if distance_m <= RECOVERED_WITHIN_M else Verdict.LATE


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """``fix``: the first pose in the map; ``last``: the one at the end; None if the robot is lost. ``places``: the
    likeliest of each search until the fix.
    """

    fix: SlamPose | None
    last: SlamPose | None
    first_ns: int
    places: list[LoopClosureRecord]
    load_s: float
    query_ms: list[float]


def _search(known: KnownMap, records: Sequence[Record], truth: PoseSeries, config: Config) -> _Search:
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
    return _Search(
        fix,
        last if slam.state != State.LOST else None,
        slam.first_stamp_ns,
        places,
        load_s + sum(query_s[:1]),
        [1e3 * seconds for seconds in query_s[1:]],
    )
