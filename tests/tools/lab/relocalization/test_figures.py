"""Statistics of kidnappings, by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from slam.common.geometry import transform_from_xyz_yaw
from tools.lab.relocalization.figures import figures, sum_up
from tools.lab.relocalization.trial import RECOVERED_WITHIN_M, Tolerance, Verdict, deviation, judge

TOLERANCE = Tolerance(1.0, 3.0)


def outcome(verdict: Verdict, distance_m: float | None, later_right: bool | None, **more: object) -> dict[str, Any]:
    """The second wrong fix is misplaced; other wrong ones are due to a bent map."""
    wrong = verdict == Verdict.WRONG
    error_m = None if distance_m is None else 7.0 if wrong else 0.01 * distance_m
    return {
        "verdict": verdict,
        "distance_m": distance_m,
        "seconds": None if distance_m is None else distance_m / 8.0,
        "error_m": error_m,
        "error_deg": error_m,
        "is_misplaced": None if distance_m is None else wrong and distance_m == 2.0,
        "later_right": later_right,
        "is_along": True,
        "objects": 7,
        "load_s": 0.1,
        "query_ms": [2.0],
        "places": [],
        **more,
    }


OUTCOMES = [
    outcome(Verdict.RECOVERED, 8.0, True, objects=4, places=[(5.0, True), (9.0, False)]),
    outcome(Verdict.RECOVERED, 10.0, True, objects=5, is_along=False),
    outcome(Verdict.RECOVERED, 30.0, False, objects=9),
    outcome(Verdict.LATE, 50.0, None, objects=10),
    outcome(Verdict.WRONG, 1.0, False, objects=19),
    outcome(Verdict.WRONG, 2.0, None, objects=20, query_ms=[8.0, 9.0]),
    outcome(Verdict.WRONG, 3.0, True, objects=400),
    outcome(Verdict.NOT_FOUND, None, None, objects=0, query_ms=[]),
]


def test_figures_of_outcomes_by_hand():
    told = figures(pd.DataFrame(OUTCOMES, dtype=object))
    assert told == pytest.approx(
        {
            "kidnaps": 8,
            "success_rate": 3 / 8,
            "late_rate": 1 / 8,
            "false_relocalization_rate": 3 / 8,
            "not_found_rate": 1 / 8,
            "success_in_map_rate": 5 / 8,  # three right ones, and two that only a bent map made wrong
            "misplaced_rate": 1 / 8,
            "median_distance_m": 20.0,
            "p95_distance_m": 47.0,
            "median_seconds": 2.5,
            "median_error_m": 0.5,
            "p95_error_m": 7.0,
            "median_error_deg": 0.5,
            "p95_error_deg": 7.0,
            "kept_rate": 2 / 4,
            "revoked_rate": 2 / 3,
        }
    )


def test_figures_of_nothing_are_none():
    empty = figures(pd.DataFrame(OUTCOMES, dtype=object)[:0])
    assert empty.pop("kidnaps") == 0
    assert set(empty.values()) == {None}
    lost = sum_up(OUTCOMES[-1:])
    assert (lost["success_rate"], lost["not_found_rate"]) == (0.0, 1.0)
    assert lost["median_distance_m"] is lost["median_error_m"] is lost["kept_rate"] is lost["query_ms"] is None


def test_groups_are_by_direction_and_by_objects_in_range():
    result = sum_up(OUTCOMES, world="w")
    assert [group["kidnaps"] for group in result["groups"].values()] == [7, 1, 2, 2, 2, 2]
    assert (result["world"], result["load_s"], result["query_ms"]) == ("w", 0.1, 2.0)
    assert (result["reliability"]["sure_count"], result["reliability"]["sure_right"]) == (2, 1)


def test_deviation_is_in_the_plane_and_the_shorter_way_round():
    a = transform_from_xyz_yaw(np.array([1.0, 2.0, 9.0]), np.deg2rad(179.0))
    b = transform_from_xyz_yaw(np.array([4.0, -2.0, 0.0]), np.deg2rad(-178.0))
    assert deviation(a, b) == deviation(b, a) == pytest.approx((5.0, 3.0))


def test_verdicts_at_their_limits():
    metres, degrees = TOLERANCE.metres, TOLERANCE.degrees
    assert judge(RECOVERED_WITHIN_M, (metres, degrees), TOLERANCE) == Verdict.RECOVERED
    assert judge(RECOVERED_WITHIN_M + 0.1, (metres, degrees), TOLERANCE) == Verdict.LATE
    assert judge(1.0, (metres + 0.1, 0.0), TOLERANCE) == Verdict.WRONG
    assert judge(1.0, (0.0, degrees + 0.1), TOLERANCE) == Verdict.WRONG
