"""Verdicts on kidnappings, and their statistics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.geometry import invert, yaw_rad
from slam.evaluation.place_recognition.reliability import bin_by_probability

RECOVERED_WITHIN_M = 40.0
"""Travel within which a right fix is a success."""
HOLDS_FOR_M = 10.0
"""Travel after which a fix is checked again."""
OBJECTS_IN_VIEW = ((0, 4), (5, 9), (10, 19), (20, None))


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A fix that is no farther from the truth, in the plane and in heading, is right."""

    metres: float
    degrees: float

    def allows(self, error_m: float, error_deg: float) -> bool:
        """Whether a fix with these errors is right."""
        return error_m <= self.metres and error_deg <= self.degrees


class Verdict(StrEnum):
    """What became of a kidnapping: a right fix soon enough, a right one later, a wrong one, or none."""

    RECOVERED = "recovered"
    LATE = "late"
    WRONG = "wrong"
    NOT_FOUND = "not found"


@dataclass(frozen=True, slots=True)
class Outcome:
    """One kidnapping, ``start_m`` along the tour, driven along the tour or against it.

    ``objects``: within the sensor's range of the place where it began; ``distance_m`` and ``seconds`` from there to the
    first fix, and its errors in the plane and in heading: None without a fix. ``local_error_m``, ``local_error_deg``:
    without the distortion of the map, which is taken at its word about where its own drive was nearby; by these it
    ``is_misplaced``, if they are too large. ``later_right``:
    whether the estimate is right 10 m after the fix, or at the end of the drive; None if the robot then knows that it
    is lost. ``refusals``: candidates refused before the fix, by stage; ``best_refusal``: that with the highest
    score, and why. ``load_s``: from the saved map to the end of the first search; ``query_ms``: each search after that
    until the fix. ``places``: of the likeliest place of each search, in a map with keyframes, its posterior log odds
    and whether it is right in the map.
    """

    number: int
    start_m: float
    is_along: bool
    objects: int
    verdict: Verdict
    distance_m: float | None
    seconds: float | None
    error_m: float | None
    error_deg: float | None
    local_error_m: float | None
    local_error_deg: float | None
    is_misplaced: bool | None
    later_right: bool | None
    refusals: dict[str, int]
    best_refusal: str
    load_s: float
    query_ms: tuple[float, ...]
    places: tuple[tuple[float, bool], ...] = ()


@dataclass(frozen=True, slots=True)
class Figures:
    """Of ``kidnaps`` kidnappings: shares of the verdicts, which add up to 1; None where there is nothing to measure.

    ``success_in_map_rate``: share that came soon enough, and right if the map is taken at its word about where its own
    drive was nearby: what relocalization does, whatever the error of the map. ``misplaced_rate``: share of fixes that
    are wrong by that measure.
    Distance and time are those of the right fixes, late ones included; errors those of all fixes, wrong ones included.
    ``kept_rate``: share of the right fixes that are still right 10 m later; ``revoked_rate``: share of the
    wrong fixes that are revoked, or have become right, 10 m later.
    """

    kidnaps: int
    success_rate: float | None
    success_in_map_rate: float | None
    late_rate: float | None
    false_relocalization_rate: float | None
    not_found_rate: float | None
    misplaced_rate: float | None
    median_distance_m: float | None
    p95_distance_m: float | None
    median_seconds: float | None
    median_error_m: float | None
    p95_error_m: float | None
    median_error_deg: float | None
    p95_error_deg: float | None
    kept_rate: float | None
    revoked_rate: float | None


@dataclass(frozen=True, slots=True)
class RelocalizationBenchmark:
    """``total`` of all outcomes, and ``groups`` of them by direction and by the number of objects in range.

    ``map_ate_m``: error (rmse) of the drive that made the map; ``load_s``: median time to take the map in;
    ``query_ms``: median time of looking for the robot's place at a keyframe; ``oracle_rate``: share of the places that
    could have been found, None if that was not asked; ``reliability``: of the posterior probabilities of all places.
    """

    world: str
    tour_m: float
    landmarks: int
    map_ate_m: float
    load_s: float
    query_ms: float | None
    total: Figures
    groups: dict[str, Figures]
    outcomes: tuple[Outcome, ...]
    reliability: dict[str, Any]
    oracle_rate: float | None = None

    def to_json_dict(self) -> dict[str, Any]:
        """All figures, in types of JSON."""
        return asdict(self)


def deviation(T_world_body_est: FloatArray, T_world_body_gt: FloatArray) -> tuple[float, float]:
    """Distance in the plane [m] and difference of heading [deg], both >= 0, of two poses (4, 4)."""
    offset = T_world_body_est[:2, 3] - T_world_body_gt[:2, 3]
    turn_rad = float(yaw_rad(invert(T_world_body_gt) @ T_world_body_est))
    return float(np.hypot(*offset)), abs(float(np.rad2deg(turn_rad)))


def judge(distance_m: float, errors: tuple[float, float], tolerance: Tolerance) -> Verdict:
    """The verdict on a fix after so much travel, with errors in metres and degrees."""
    if not tolerance.allows(*errors):
        return Verdict.WRONG
    return Verdict.RECOVERED if distance_m <= RECOVERED_WITHIN_M else Verdict.LATE


def sum_up(
    outcomes: Sequence[Outcome],
    *,
    world: str,
    tour_m: float,
    landmarks: int,
    map_ate_m: float,
    oracle_rate: float | None = None,
) -> RelocalizationBenchmark:
    """All figures of at least one outcome."""
    groups = {
        "same direction": [each for each in outcomes if each.is_along],
        "opposite direction": [each for each in outcomes if not each.is_along],
    }
    for least, most in OBJECTS_IN_VIEW:
        name = f"{least}+ objects" if most is None else f"{least}-{most} objects"
        groups[name] = [each for each in outcomes if least <= each.objects and (most is None or each.objects <= most)]
    return RelocalizationBenchmark(
        world=world,
        tour_m=tour_m,
        landmarks=landmarks,
        map_ate_m=map_ate_m,
        load_s=float(np.median([each.load_s for each in outcomes])),
        query_ms=_percentile((ms for each in outcomes for ms in each.query_ms), 50.0),
        total=figures(outcomes),
        groups={name: figures(members) for name, members in groups.items()},
        outcomes=tuple(outcomes),
        reliability=bin_by_probability(
            np.array([odds for each in outcomes for odds, _ in each.places], dtype=np.float64),
            np.array([right for each in outcomes for _, right in each.places], dtype=np.bool_),
        ),
        oracle_rate=oracle_rate,
    )


def figures(outcomes: Sequence[Outcome]) -> Figures:
    """Shares and percentiles of any number of outcomes."""
    right = [each for each in outcomes if each.verdict in (Verdict.RECOVERED, Verdict.LATE)]
    wrong = [each for each in outcomes if each.verdict == Verdict.WRONG]
    shares = {verdict: _share(each.verdict == verdict for each in outcomes) for verdict in Verdict}
    return Figures(
        kidnaps=len(outcomes),
        success_rate=shares[Verdict.RECOVERED],
        success_in_map_rate=_share(_is_found_in_map(each) for each in outcomes),
        late_rate=shares[Verdict.LATE],
        false_relocalization_rate=shares[Verdict.WRONG],
        not_found_rate=shares[Verdict.NOT_FOUND],
        misplaced_rate=_share(each.is_misplaced is True for each in outcomes),
        median_distance_m=_percentile((each.distance_m for each in right), 50.0),
        p95_distance_m=_percentile((each.distance_m for each in right), 95.0),
        median_seconds=_percentile((each.seconds for each in right), 50.0),
        median_error_m=_percentile((each.error_m for each in outcomes), 50.0),
        p95_error_m=_percentile((each.error_m for each in outcomes), 95.0),
        median_error_deg=_percentile((each.error_deg for each in outcomes), 50.0),
        p95_error_deg=_percentile((each.error_deg for each in outcomes), 95.0),
        kept_rate=_share(each.later_right is True for each in right),
        revoked_rate=_share(each.later_right is not False for each in wrong),
    )


def _is_found_in_map(outcome: Outcome) -> bool:
    return outcome.distance_m is not None and outcome.distance_m <= RECOVERED_WITHIN_M and outcome.is_misplaced is False


def _share(whether: Iterable[bool]) -> float | None:
    listed = list(whether)
    return sum(listed) / len(listed) if listed else None


def _percentile(values: Iterable[float | None], percent: float) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.percentile(known, percent)) if known else None
