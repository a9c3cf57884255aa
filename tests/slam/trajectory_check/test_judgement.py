"""Which trajectory predicts detections on other visits, against simulated drives whose truth is known."""

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.trajectory_check.judgement import TrajectoryCheck, check_trajectories
from tests.slam.trajectory_check.drives import RANGE_M, SIGMA_M, UPRIGHT, circle, drifting, scans_of


def check(
    T_true: FloatArray, odometry: FloatArray, online: FloatArray, final: FloatArray, T_body_sensor: FloatArray = UPRIGHT
) -> TrajectoryCheck:
    """Of trajectories of the sensor, whose axes ``T_body_sensor`` turns."""
    found = {"odometry": odometry, "online": online, "final": final}
    trajectories = {name: T @ T_body_sensor for name, T in found.items()}
    scans = scans_of(T_true, T_body_sensor=T_body_sensor)
    return check_trajectories(scans, trajectories, sensor_range_m=RANGE_M, sigma_m=SIGMA_M)


def with_wrong_associations(T: FloatArray) -> FloatArray:
    """Poses that some scans displaced by as much as objects are apart, so that all that follow are wrong."""
    moved = T.copy()
    for index, offset in ((60, [6.0, 0.0, 0.0]), (130, [0.0, 7.0, 0.0]), (170, [5.0, -3.0, 0.0])):
        moved[index:, :3, 3] += offset
    return moved


TRUE = circle()
WRONG = with_wrong_associations(TRUE)


@pytest.mark.parametrize(
    ("odometry", "online", "final", "better"),
    [
        pytest.param(drifting(TRUE, 4.0), drifting(TRUE, 1.0), TRUE, None, id="the final one is the best"),
        pytest.param(drifting(TRUE, 2.0), WRONG, WRONG, "odometry", id="wrong associations"),
        pytest.param(drifting(TRUE, 2.0), TRUE, WRONG, "online", id="the best of two better ones"),
        pytest.param(TRUE, TRUE, drifting(TRUE, 0.02), None, id="slightly better"),
        # The odometry has the two visits apart, where nothing refutes it; the final one has them at wrong places.
        pytest.param(drifting(TRUE, 400.0), WRONG, drifting(TRUE, 60.0), None, id="no better than chance"),
    ],
)
def test_significantly_better_trajectory_is_named(
    odometry: FloatArray, online: FloatArray, final: FloatArray, better: str | None
) -> None:
    assert check(TRUE, odometry, online, final).better == better


def test_drive_without_revisits_cannot_be_judged() -> None:
    T = circle(rounds=0.7)
    result = check(T, drifting(T, 2.0), T, with_wrong_associations(T))
    assert result == TrajectoryCheck()
    assert "cannot tell" in str(result)


def test_axes_of_the_body_do_not_matter() -> None:
    """A camera looks along its z axis, and may be what the odometry calls the body."""
    optical = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    upright, turned = (check(TRUE, drifting(TRUE, 2.0), TRUE, TRUE, axes) for axes in (UPRIGHT, optical))
    assert turned.gains == pytest.approx(upright.gains, abs=0.15)
