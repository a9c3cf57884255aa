"""The posterior over where the robot is, without driving: each rule, and that it matters."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.special import expit

from slam.common.arrays import FloatArray
from slam.common.config import LocalizationConfig
from slam.common.geometry import transform_from_xyz_yaw
from slam.loop_closure.candidate import Candidate, Query
from slam.loop_closure.consistency import which_agree
from slam.loop_closure.localizer import Localizer, Posterior
from tests.helpers.candidates import make_candidate
from tests.slam.loop_closure.doubles import make_keyframe, make_submap

MEMORY_M = 50.0
PRIOR = -15.0


def pose(x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0) -> FloatArray:
    return transform_from_xyz_yaw(np.array([x_m, y_m, 0.0]), yaw_rad)


def evidence(
    T: FloatArray,
    llrs: dict[int, float],
    *,
    segment: int = 0,
    log_prior: float = PRIOR,
    log_uniform: float = -100.0,
) -> Candidate:
    return make_candidate(
        reference=make_keyframe(0, 0.0, segment=segment),
        T_local_query=T,
        llrs=llrs,
        odometry_penalty=-log_prior,
        unpredicted_penalty=-log_uniform,
    )


class Robot:
    """Drives straight ahead, in a map that it entered with another heading."""

    def __init__(self, *, max_hypotheses: int = 5) -> None:
        config = LocalizationConfig(max_hypotheses=max_hypotheses)
        self.localizer = Localizer(
            config, partial(which_agree, sensor_range_m=30.0), lambda *_: self.together, memory_m=MEMORY_M
        )
        self.travel_m, self.together = 0.0, False

    @property
    def query(self) -> Query:
        return Query(make_keyframe(1, self.travel_m), make_submap(np.zeros((0, 3))), pose(self.travel_m, 5.0, 0.3))

    def drive(self, length_m: float) -> None:
        self.travel_m += length_m

    def measure(self, *measured: Candidate, together: bool = False) -> Posterior:
        self.together = together
        return self.localizer.update(self.query, measured)


@pytest.fixture
def robot() -> Robot:
    return Robot()


def there(travel_m: float) -> FloatArray:
    """Where the map has the robot after some travel, in x of the odometry, from a first pose of its own."""
    return pose(100.0, 0.0, 1.0) @ np.linalg.inv(pose(0.0, 5.0, 0.3)) @ pose(travel_m, 5.0, 0.3)


def test_one_pose_against_somewhere_new(robot):
    posterior = robot.measure(evidence(pose(), {1: 10.0, 2: 8.0}))
    assert posterior.log_odds == pytest.approx([3.0])
    assert posterior.posterior_log_odds == pytest.approx([3.0])
    assert robot.measure(evidence(pose(500.0), {3: 15.0})).posterior_log_odds == pytest.approx([0.0], abs=1e-9)


def test_two_poses_that_fit_alike_are_ambiguous_unless_both_can_be_true(robot):
    alike = evidence(pose(), {1: 40.0}), evidence(pose(80.0), {1: 40.0})
    assert expit(robot.measure(*alike).posterior_log_odds) == pytest.approx([0.5, 0.5])
    assert expit(Robot().measure(*alike, together=True).posterior_log_odds) == pytest.approx([1.0, 1.0])


def test_posterior_odds_are_against_the_rivals_and_somewhere_new():
    posterior = Robot().measure(evidence(pose(0.0), {1: 40.0}), evidence(pose(50.0), {1: 38.0}))
    against_first = np.logaddexp(38.0 + PRIOR, 0.0)
    assert posterior.posterior_log_odds[0] == pytest.approx(40.0 + PRIOR - against_first)
    assert posterior.log_odds == pytest.approx([40.0 + PRIOR, 38.0 + PRIOR])


def test_a_place_unlike_all_others_may_be_new_where_others_are_alike():
    other = {"log_prior": -30.0, "log_uniform": -25.0}  # by chance a pose in the area reaches an LLR of 25
    best = evidence(pose(), {1: 48.0}, log_uniform=-25.0)
    (alone,) = Robot().measure(best).posterior_log_odds
    by_chance, _ = Robot().measure(best, evidence(pose(80.0), {1: 25.0}, **other)).posterior_log_odds
    alike, _ = Robot().measure(best, evidence(pose(80.0), {1: 40.0}, **other)).posterior_log_odds
    assert alone == pytest.approx(48.0 + PRIOR)
    assert by_chance == pytest.approx(alone, abs=0.01)
    # What is new looks like the other place at 1 of exp(25) poses.
    assert alike == pytest.approx(48.0 + PRIOR - np.logaddexp(40.0 - 25.0, 10.0))
    both, _ = Robot().measure(best, evidence(pose(80.0), {1: 40.0}, **other), together=True).posterior_log_odds
    assert both == pytest.approx(np.logaddexp(48.0 + PRIOR, 10.0))


def test_the_likeliest_is_the_best(robot):
    assert robot.measure(evidence(pose(), {1: 20.0}), evidence(pose(80.0), {1: 22.0})).best == 1


def test_what_was_left_behind_does_not_speak_for_a_pose(robot):
    robot.measure(evidence(there(0.0), {1: 8.0, 2: 8.0}))
    robot.drive(20.0)
    assert robot.measure(evidence(there(20.0), {3: 8.0})).log_odds == pytest.approx([8.0 + PRIOR])


def test_what_was_left_behind_speaks_against_a_pose_as_long_as_it_is_measured(robot):
    robot.measure(evidence(there(0.0), {1: -4.0, 2: -3.0, 3: 1.0}))
    for travel_m in (20.0, 40.0, 60.0):
        robot.travel_m = travel_m
        posterior = robot.measure(evidence(there(travel_m), {3: 8.0}))
        assert posterior.log_odds == pytest.approx([8.0 - 7.0 + PRIOR])


def test_a_landmark_counts_once_with_what_was_last_known_of_it(robot):
    for llr in (8.0, 9.0, 5.0):
        posterior = robot.measure(evidence(there(robot.travel_m), {1: llr, 2: 7.0}))
        assert posterior.log_odds == pytest.approx([llr + 7.0 + PRIOR])
        robot.drive(2.0)


def test_the_prior_counts_once(robot):
    for log_prior in (-15.0, -14.0):
        posterior = robot.measure(evidence(pose(), {1: 16.0}, log_prior=log_prior))
        assert posterior.log_odds == pytest.approx([16.0 + log_prior])


def test_a_pose_that_the_odometry_does_not_lead_to_is_another_hypothesis(robot):
    robot.measure(evidence(there(0.0), {1: -6.0}))
    robot.drive(20.0)
    for T in (there(0.0), there(20.0) @ pose(0.0, 0.0, 0.3), there(23.0)):
        assert robot.measure(evidence(T, {2: 3.0})).log_odds == pytest.approx([3.0 + PRIOR])


def test_hypotheses_of_another_segment_are_others(robot):
    robot.measure(evidence(there(0.0), {1: -6.0}, segment=1))
    assert robot.measure(evidence(there(0.0), {2: 3.0}, segment=0)).log_odds == pytest.approx([3.0 + PRIOR])


def test_what_is_no_longer_measured_is_forgotten(robot):
    for travel_m, expected in ((0.0, -6.0), (MEMORY_M, -12.0), (2.0 * MEMORY_M + 1.0, -6.0)):
        robot.travel_m = travel_m
        rows = {int(travel_m): -6.0}
        assert robot.measure(evidence(there(travel_m), rows)).log_odds == pytest.approx([expected + PRIOR])


def test_forgetting_everything(robot):
    robot.measure(evidence(there(0.0), {1: -6.0}))
    robot.localizer.reset()
    assert robot.localizer.predictions(robot.query) == []
    assert robot.measure(evidence(there(0.0), {2: 3.0})).log_odds == pytest.approx([3.0 + PRIOR])


def test_the_likeliest_hypotheses_are_predicted_by_the_odometry():
    robot = Robot(max_hypotheses=2)
    robot.measure(
        evidence(pose(-300.0), {1: 5.0}), evidence(there(0.0), {1: 9.0}), evidence(pose(300.0), {1: 7.0}, segment=4)
    )
    robot.drive(10.0)
    predicted = robot.localizer.predictions(robot.query)
    assert [segment for segment, _ in predicted] == [0, 4]
    np.testing.assert_allclose(predicted[0][1], there(10.0), atol=1e-9)


def test_a_hypothesis_with_landmarks_against_it_is_not_measured_again(robot):
    robot.measure(evidence(there(0.0), {1: 3.0, 2: -2.0}), evidence(pose(900.0), {3: 3.0, 4: -4.0}))
    robot.drive(2.0)
    (predicted,) = robot.localizer.predictions(robot.query)
    np.testing.assert_allclose(predicted[1], there(2.0), atol=1e-9)


def test_a_hypothesis_that_is_measured_again_is_not_kept_twice(robot):
    for _ in range(3):
        robot.measure(evidence(there(robot.travel_m), {1: 9.0}))
        robot.drive(2.0)
    assert len(robot.localizer.predictions(robot.query)) == 1
