"""The posterior over where the robot is, without driving: each rule, and that it matters."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.config import LocalizationConfig
from slam.common.geometry import transform_from_xyz_yaw
from slam.localization.localizer import Localizer, PoseEvidence, Posterior, log_odds_of

MEMORY_M = 50.0
PRIOR = -15.0


def pose(x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0) -> FloatArray:
    return transform_from_xyz_yaw(np.array([x_m, y_m, 0.0]), yaw_rad)


def evidence(T: FloatArray, llr: float, *, segment: int = 0, log_prior: float = PRIOR) -> PoseEvidence:
    return PoseEvidence(T, segment, log_prior, llr)


class Robot:
    """Drives straight ahead, in a map that it entered with another heading."""

    def __init__(self, *, max_hypotheses: int = 5) -> None:
        self.localizer = Localizer(LocalizationConfig(max_hypotheses=max_hypotheses), memory_m=MEMORY_M)
        self.travel_m = 0.0

    @property
    def T_odom(self) -> FloatArray:
        return pose(self.travel_m, 5.0, 0.3)

    def drive(self, length_m: float) -> None:
        self.travel_m += length_m

    def measure(self, *measured: PoseEvidence, together: bool = False) -> Posterior:
        return self.localizer.update(self.T_odom, self.travel_m, measured, lambda i, j: together)

    def predictions(self) -> list[tuple[int, FloatArray]]:
        return self.localizer.predictions(self.T_odom, self.travel_m)


@pytest.fixture
def robot() -> Robot:
    return Robot()


def there(travel_m: float) -> FloatArray:
    """Where the map has the robot after some travel, in x of the odometry, from a first pose of its own."""
    return pose(100.0, 0.0, 1.0) @ np.linalg.inv(pose(0.0, 5.0, 0.3)) @ pose(travel_m, 5.0, 0.3)


def test_one_pose_against_somewhere_new(robot):
    posterior = robot.measure(evidence(pose(), 18.0))
    assert posterior.log_odds == pytest.approx([3.0])
    assert posterior.probabilities == pytest.approx([1.0 / (1.0 + np.exp(-3.0))])
    assert robot.measure(evidence(pose(500.0), 15.0)).probabilities == pytest.approx([0.5])


def test_two_poses_that_fit_alike_are_ambiguous_unless_both_can_be_true(robot):
    alike = evidence(pose(), 40.0), evidence(pose(80.0), 40.0)
    assert robot.measure(*alike).probabilities == pytest.approx([0.5, 0.5])
    assert Robot().measure(*alike, together=True).probabilities == pytest.approx([1.0, 1.0])


def test_the_likeliest_is_the_best(robot):
    assert robot.measure(evidence(pose(), 20.0), evidence(pose(80.0), 22.0)).best == 1


def test_what_an_earlier_keyframe_said_does_not_count_again(robot):
    for llr in (16.0, 17.0, 3.0):
        assert robot.measure(evidence(there(robot.travel_m), llr)).log_odds == pytest.approx([llr + PRIOR])
        robot.drive(2.0)


def test_what_is_no_longer_measured_is_forgotten(robot):
    robot.measure(evidence(there(0.0), 8.0))
    robot.drive(MEMORY_M)
    assert len(robot.predictions()) == 1
    robot.drive(1.0)
    assert robot.predictions() == []


def test_a_hypothesis_that_is_measured_elsewhere_is_given_up(robot):
    robot.measure(evidence(pose(-300.0), 8.0))
    robot.drive(2.0)
    robot.measure(evidence(pose(300.0), 8.0))
    np.testing.assert_allclose([T for _, T in robot.predictions()], [pose(300.0)], atol=1e-9)


def test_forgetting_everything(robot):
    robot.measure(evidence(there(0.0), 16.0))
    robot.localizer.reset()
    assert robot.predictions() == []


def test_the_likeliest_hypotheses_are_predicted_by_the_odometry():
    robot = Robot(max_hypotheses=2)
    robot.measure(evidence(pose(-300.0), 5.0), evidence(there(0.0), 9.0), evidence(pose(300.0), 7.0, segment=4))
    robot.drive(10.0)
    predicted = robot.predictions()
    assert [segment for segment, _ in predicted] == [0, 4]
    np.testing.assert_allclose(predicted[0][1], there(10.0), atol=1e-9)


def test_log_odds():
    assert log_odds_of(0.5) == 0.0
    assert log_odds_of(0.995) == pytest.approx(np.log(199.0))
