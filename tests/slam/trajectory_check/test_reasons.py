"""The likely reason why another trajectory is better."""

from dataclasses import replace
from typing import Any

import pytest

from slam.assessment import explain
from slam.common.calibration import Calibration
from slam.trajectory_check.judgement import TrajectoryCheck

CHECK = TrajectoryCheck({"odometry": 0.5, "online": -0.6, "final": -0.8}, "odometry", 1000)


def reason(
    check: TrajectoryCheck = CHECK,
    *,
    moving_share: float = 0.0,
    spacing_m: float = 8.0,
    counters: dict[str, int] | None = None,
) -> str:
    calibration = Calibration().with_values({"objects.spacing_m": spacing_m})
    return explain(check, moving_share, counters or {}, calibration)


@pytest.mark.parametrize("check", [TrajectoryCheck(), replace(CHECK, better=None)])
def test_final_trajectory_that_is_not_worse_needs_no_reason(check: TrajectoryCheck) -> None:
    assert reason(check, moving_share=0.5) == ""


def test_warning_names_better_trajectory_and_advantage() -> None:
    assert reason().startswith("the odometry alone is better than the final trajectory")
    assert "1.3 nats" in reason()
    assert reason(replace(CHECK, better="online")).startswith("the online estimate is better")


@pytest.mark.parametrize(
    ("signs", "told"),
    [
        ({}, "no closure corrects it"),
        ({"counters": {"closures_inserted": 7}}, "some of the 7 closures in the graph are probably false"),
        ({"moving_share": 0.05, "counters": {"closures_inserted": 7}}, "some of the 7 closures"),
        ({"moving_share": 0.5}, "wrong landmarks: 50 % of the objects seem to move"),
        ({"spacing_m": 1.5}, "objects of a class are 1.5 m apart, and detections at the sensor range err by 0.5 m"),
        ({"counters": {"odometry_corrected": 44}}, "wrong landmarks: they corrected the odometry 44 times"),
    ],
)
def test_reason_is_that_of_the_signs(signs: dict[str, Any], told: str) -> None:
    assert told in reason(**signs)
