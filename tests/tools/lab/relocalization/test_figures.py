"""Statistics of kidnappings, by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.inputs.protocol import Protocol
from tools.lab.relocalization.figures import figures, sum_up
from tools.lab.relocalization.trial import RECOVERED_WITHIN_M, Verdict, deviation, judge


def outcome(verdict: Verdict, distance_m: float | None, later_right: bool | None, **more: object) -> dict[str, Any]:
    error_m = None if distance_m is None else 7.0 if verdict == Verdict.WRONG else 0.01 * distance_m
    return {
        "verdict": verdict,
        "distance_m": distance_m,
        "seconds": None if distance_m is None else distance_m / 8.0,
        "error_m": error_m,
        "error_deg": error_m,
        "later_right": later_right,
        "is_along": True,
        "objects": 7,
        "load_s": 0.1,
        "query_ms": [2.0],
        **more,
    }


OUTCOMES = [
    outcome(Verdict.RECOVERED, 8.0, True, objects=4),
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


def test_groups_are_by_direction_and_by_objects_in_first_scan():
    result = sum_up(OUTCOMES, drive="d")
    assert [group["kidnaps"] for group in result["groups"].values()] == [7, 1, 2, 2, 2, 2]
    assert (result["drive"], result["load_s"], result["query_ms"]) == ("d", 0.1, 2.0)
    assert list(sum_up([outcome(Verdict.LATE, 50.0, True, is_along=None)])["groups"]) == ["5-9 objects"]


def test_deviation_is_in_the_plane_and_the_shorter_way_round():
    a = transform_from_xyz_yaw(np.array([1.0, 2.0, 9.0]), np.deg2rad(179.0))
    b = transform_from_xyz_yaw(np.array([4.0, -2.0, 0.0]), np.deg2rad(-178.0))
    assert deviation(a, b) == deviation(b, a) == pytest.approx((5.0, 3.0))


def test_verdicts_at_their_limits():
    protocol = Protocol()
    metres, degrees = protocol.closure_translation_m, protocol.closure_rotation_deg
    assert judge(RECOVERED_WITHIN_M, (metres, degrees), protocol) == Verdict.RECOVERED
    assert judge(RECOVERED_WITHIN_M + 0.1, (metres, degrees), protocol) == Verdict.LATE
    assert judge(1.0, (metres + 0.1, 0.0), protocol) == Verdict.WRONG
    assert judge(1.0, (0.0, degrees + 0.1), protocol) == Verdict.WRONG
