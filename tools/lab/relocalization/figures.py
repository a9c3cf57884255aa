"""Verdicts on kidnappings, and their statistics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.geometry import invert, yaw_rad
from slam.evaluation.metrics.statistics import fraction, percentile
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

    def allows(self, error_m: float | None, error_deg: float | None) -> bool:
        """Whether a fix with these errors is right; without a fix it is not."""
        if error_m is None or error_deg is None:
            return False
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
    ``is_misplaced``, if they are too large. ``later_right``: whether the estimate is right 10 m after the fix, or at
    the end of the drive; None if the robot then knows that it is lost. ``load_s``: from the saved map to the end of the
    first search; ``query_ms``: each search after that until the fix. ``places``: of the likeliest place of each search,
    in a map with keyframes, its posterior log odds and whether it is right in the map.
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
    load_s: float
    query_ms: tuple[float, ...]
    places: tuple[tuple[float, bool], ...] = ()


def deviation(T_world_body_est: FloatArray, T_world_body_gt: FloatArray) -> tuple[float, float]:
    """Distance in the plane [m] and difference of heading [deg], both >= 0, of two poses (4, 4)."""
    offset = T_world_body_est[:2, 3] - T_world_body_gt[:2, 3]
    turn_rad = float(yaw_rad(invert(T_world_body_gt) @ T_world_body_est))
    return float(np.hypot(*offset)), abs(float(np.rad2deg(turn_rad)))


def judge(distance_m: float | None, errors: tuple[float, float] | tuple[None, None], tolerance: Tolerance) -> Verdict:
    """The verdict on a fix after so much travel, with errors in metres and degrees; None without a fix."""
    if distance_m is None:
        return Verdict.NOT_FOUND
    if not tolerance.allows(*errors):
        return Verdict.WRONG
    return Verdict.RECOVERED if distance_m <= RECOVERED_WITHIN_M else Verdict.LATE


def sum_up(outcomes: Sequence[Outcome], **about: Any) -> dict[str, Any]:
    """All figures of at least one outcome, in types of JSON.

    Args:
        outcomes: of the kidnappings.
        about: what else is known of the benchmark.

    Returns:
        What is given, the figures of all outcomes (:func:`figures`), those of ``groups`` by direction and by the number
        of objects in range, ``load_s`` (median time to load the map), ``query_ms`` (median time of a search),
        ``reliability`` of the posterior probabilities of all places, and the ``outcomes``.
    """
    groups = {
        "same direction": [each for each in outcomes if each.is_along],
        "opposite direction": [each for each in outcomes if not each.is_along],
    }
    for least, most in OBJECTS_IN_VIEW:
        name = f"{least}+ objects" if most is None else f"{least}-{most} objects"
        groups[name] = [each for each in outcomes if least <= each.objects and (most is None or each.objects <= most)]
    return {
        **about,
        **figures(outcomes),
        "load_s": percentile([each.load_s for each in outcomes], 50.0),
        "query_ms": percentile([ms for each in outcomes for ms in each.query_ms], 50.0),
        "groups": {name: figures(members) for name, members in groups.items()},
        "reliability": bin_by_probability(
            np.array([odds for each in outcomes for odds, _ in each.places], dtype=np.float64),
            np.array([right for each in outcomes for _, right in each.places], dtype=np.bool_),
        ),
        "outcomes": [asdict(each) for each in outcomes],
    }


def figures(outcomes: Sequence[Outcome]) -> dict[str, float | None]:
    """Shares and percentiles of any number of outcomes; None where there is nothing to measure.

    The shares of the verdicts add up to 1. ``success_in_map_rate``: share that came soon enough, and right if the map
    is taken at its word about where its own drive was nearby: what relocalization does, whatever the error of the map.
    ``misplaced_rate``: share of fixes that are wrong by that measure. Distance and time are those of the right fixes,
    late ones included; errors those of all fixes. ``kept_rate``: share of the right fixes that are still right 10 m
    later; ``revoked_rate``: share of the wrong fixes that are revoked, or have become right, 10 m later.
    """
    right = [each for each in outcomes if each.verdict in (Verdict.RECOVERED, Verdict.LATE)]
    wrong = [each for each in outcomes if each.verdict == Verdict.WRONG]
    shares = {verdict: _share(each.verdict == verdict for each in outcomes) for verdict in Verdict}
    return {
        "kidnaps": len(outcomes),
        "success_rate": shares[Verdict.RECOVERED],
        "success_in_map_rate": _share(_is_found_in_map(each) for each in outcomes),
        "late_rate": shares[Verdict.LATE],
        "false_relocalization_rate": shares[Verdict.WRONG],
        "not_found_rate": shares[Verdict.NOT_FOUND],
        "misplaced_rate": _share(each.is_misplaced is True for each in outcomes),
        "median_distance_m": percentile([each.distance_m for each in right], 50.0),
        "p95_distance_m": percentile([each.distance_m for each in right], 95.0),
        "median_seconds": percentile([each.seconds for each in right], 50.0),
        "median_error_m": percentile([each.error_m for each in outcomes], 50.0),
        "p95_error_m": percentile([each.error_m for each in outcomes], 95.0),
        "median_error_deg": percentile([each.error_deg for each in outcomes], 50.0),
        "p95_error_deg": percentile([each.error_deg for each in outcomes], 95.0),
        "kept_rate": _share(each.later_right is True for each in right),
        "revoked_rate": _share(each.later_right is not False for each in wrong),
    }


def _is_found_in_map(outcome: Outcome) -> bool:
    return outcome.distance_m is not None and outcome.distance_m <= RECOVERED_WITHIN_M and outcome.is_misplaced is False


def _share(whether: Iterable[bool]) -> float | None:
    listed = list(whether)
    return fraction(sum(listed), len(listed))
