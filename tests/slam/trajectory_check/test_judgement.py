"""Which trajectory predicts detections on other visits, against simulated drives whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.trajectory_check.judgement import TrajectoryCheck, check_trajectories
from tests.slam.trajectory_check.drives import RANGE_M, SIGMA_M, circle, drifting, scans_of


def check(T_true: FloatArray, *, odometry: FloatArray, online: FloatArray, final: FloatArray) -> TrajectoryCheck:
    trajectories = {"odometry": odometry, "online": online, "final": final}
    return check_trajectories(scans_of(T_true), trajectories, sensor_range_m=RANGE_M, sigma_m=SIGMA_M)


def with_wrong_associations(T: FloatArray) -> FloatArray:
    """Poses that some scans displaced by as much as objects are apart, so that all that follow are wrong."""
    moved = T.copy()
    for index, offset in ((60, [6.0, 0.0, 0.0]), (130, [0.0, 7.0, 0.0]), (170, [5.0, -3.0, 0.0])):
        moved[index:, :3, 3] += offset
    return moved


def test_good_final_trajectory_is_not_doubted() -> None:
    T = circle()
    result = check(T, odometry=drifting(T, 4.0), online=drifting(T, 1.0), final=T)
    assert result.better is None
    assert result.gains["final"] > result.gains["online"] > result.gains["odometry"]
    assert result.detections > 1000


def test_wrongly_associated_final_trajectory_is_worse_than_odometry() -> None:
    T = circle()
    wrong = with_wrong_associations(T)
    result = check(T, odometry=drifting(T, 2.0), online=wrong, final=wrong)
    assert result.better == "odometry"
    assert "the odometry is significantly better" in str(result)


def test_best_of_two_better_trajectories_is_named() -> None:
    T = circle()
    assert check(T, odometry=drifting(T, 2.0), online=T, final=with_wrong_associations(T)).better == "online"


def test_slightly_better_trajectory_is_not_told() -> None:
    T = circle()
    assert check(T, odometry=T, online=T, final=drifting(T, 0.02)).better is None


def test_trajectory_that_predicts_no_better_than_chance_is_not_better() -> None:
    """The odometry has the two visits apart, where nothing refutes it; the final one has them at wrong places."""
    T = circle()
    result = check(T, odometry=drifting(T, 400.0), online=with_wrong_associations(T), final=drifting(T, 60.0))
    assert result.better is None


def test_drive_without_revisits_cannot_be_judged() -> None:
    T = circle(rounds=0.7)
    result = check(T, odometry=drifting(T, 2.0), online=T, final=with_wrong_associations(T))
    assert result == TrajectoryCheck()
    assert "cannot tell" in str(result)


def test_axes_of_the_body_do_not_matter() -> None:
    """A camera looks along its z axis, and may be what the odometry calls the body."""
    T = circle()
    optical = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    upright = check(T, odometry=drifting(T, 2.0), online=T, final=T)
    scans = scans_of(T, T_body_sensor=optical)
    trajectories = {"odometry": drifting(T, 2.0) @ optical, "online": T @ optical, "final": T @ optical}
    turned = check_trajectories(scans, trajectories, sensor_range_m=RANGE_M, sigma_m=SIGMA_M)
    assert turned.gains == pytest.approx(upright.gains, abs=0.15)
