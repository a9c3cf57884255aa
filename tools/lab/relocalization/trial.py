"""One kidnapping: the robot starts at an unknown place and drives until it is relocalized."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from logs.messages import GroundTruthPose, Record, SlamPose
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import interpolate, invert, yaw_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.localization.state import State
from slam.system import Slam
from tools.lab.relocalization.known_map import KnownMap, truth_of

RECOVERED_WITHIN_M = 40.0
"""Travel within which a right fix is a success."""
HOLDS_FOR_M = 10.0
"""Travel after which a fix is checked again."""


class Verdict(StrEnum):
    """The result of a kidnapping: a right fix soon enough, a right one later, a wrong one, or none."""

    RECOVERED = "recovered"
    LATE = "late"
    WRONG = "wrong"
    NOT_FOUND = "not found"


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Measurements from the start of the search on, and the truth, in the order of a log.

    ``start_m`` along the whole drive; ``is_along``: in the direction of the drive that made the map, None if no drive
    made it; ``objects``: number of those in the first scan.
    """

    number: int
    start_m: float
    is_along: bool | None
    objects: int
    records: Sequence[Record]


def put_down(known: KnownMap, drive: Drive, config: Config, protocol: Protocol) -> dict[str, Any]:
    """Drive until the robot is localized in the map, and 10 m more.

    Returns:
        ``number``, ``start_m``, ``is_along`` and ``objects`` of the drive, the ``verdict``, and of the first fix
        ``distance_m`` and ``seconds`` from the start, ``error_m`` and ``error_deg`` in the plane and in heading, None
        without a fix. ``later_right``: whether the estimate is right 10 m after the fix, or at the end of the drive;
        None if the robot is lost then. ``load_s``: from the saved map to the end of the first search; ``query_ms``:
        each search after that until the fix.
    """
    truth = truth_of(drive.records)
    search = _search(known, drive.records, truth, config)
    fix, last = search.fix, search.last
    outcome: dict[str, Any] = {
        "number": drive.number,
        "start_m": drive.start_m,
        "is_along": drive.is_along,
        "objects": drive.objects,
        "verdict": Verdict.NOT_FOUND,
        **dict.fromkeys(("distance_m", "seconds", "error_m", "error_deg")),
        "later_right": is_right(measure_error(known, last, truth), protocol) if last else None,
        "load_s": search.load_s,
        "query_ms": search.query_ms,
    }
    if fix is not None:
        error, distance_m = measure_error(known, fix, truth), travel_m(truth, fix)
        outcome |= {
            "verdict": judge(distance_m, error, protocol),
            "distance_m": distance_m,
            "seconds": 1e-9 * (fix.stamp_ns - search.first_ns),
            **dict(zip(("error_m", "error_deg"), error, strict=True)),
        }
    return outcome


def measure_error(known: KnownMap, pose: SlamPose, truth: PoseSeries) -> tuple[float, float]:
    """Distance in the plane [m] and difference of heading [deg] of an estimate from the truth at its time."""
    at_ns = np.clip(np.array([pose.stamp_ns], dtype=np.int64), truth.stamps_ns[0], truth.stamps_ns[-1])
    T_world_body = np.asarray(interpolate(truth.stamps_ns, truth.T_world_body, at_ns)[0])
    return deviation(known.to_world(pose.T_map_body, T_world_body), T_world_body)


def deviation(T_world_body_est: FloatArray, T_world_body_gt: FloatArray) -> tuple[float, float]:
    """Distance in the plane [m] and difference of heading [deg], both >= 0, of two poses (4, 4)."""
    offset = T_world_body_est[:2, 3] - T_world_body_gt[:2, 3]
    turn_rad = float(yaw_rad(invert(T_world_body_gt) @ T_world_body_est))
    return float(np.hypot(*offset)), abs(float(np.rad2deg(turn_rad)))


def is_right(error: tuple[float, float], protocol: Protocol) -> bool:
    """Whether a fix with this error [m], [deg] is right."""
    return error[0] <= protocol.closure_translation_m and error[1] <= protocol.closure_rotation_deg


def judge(distance_m: float, error: tuple[float, float], protocol: Protocol) -> Verdict:
    """The verdict on a fix after so much travel, with an error in metres and degrees."""
    if not is_right(error, protocol):
        return Verdict.WRONG
    return Verdict.RECOVERED if distance_m <= RECOVERED_WITHIN_M else Verdict.LATE


def travel_m(truth: PoseSeries, record: Record) -> float:
    """True travel from the start of a drive to a record."""
    return float(truth.travelled_at_m(np.array([record.stamp_ns]))[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """``fix``: the first pose in the map; ``last``: the one at the end; None if the robot is lost."""

    fix: SlamPose | None
    last: SlamPose | None
    first_ns: int
    load_s: float
    query_ms: list[float]


def _search(known: KnownMap, records: Sequence[Record], truth: PoseSeries, config: Config) -> _Search:
    started = time.perf_counter()
    slam = Slam(config, known.saved, extend=False)
    load_s = time.perf_counter() - started
    fix: SlamPose | None = None
    last: SlamPose | None = None
    query_s: list[float] = []
    for record in records:
        if isinstance(record, GroundTruthPose):
            continue
        if fix is not None and travel_m(truth, record) > travel_m(truth, fix) + HOLDS_FOR_M:
            break
        last = next((each for each in reversed(slam.process(record)) if isinstance(each, SlamPose)), last)
        if fix is None:
            fix, query_s = last, list(slam.closing_seconds)
    # The first search enters the whole map into the index of places before it begins.
    return _Search(
        fix,
        last if slam.state != State.LOST else None,
        slam.first_stamp_ns,
        load_s + sum(query_s[:1]),
        [1e3 * seconds for seconds in query_s[1:]],
    )
