"""ObservationGroup: the sum of a group is the information-weighted mean in the frame of its last keyframe."""

from dataclasses import replace

import numpy as np
import pytest

from slam.backend.factors import Observation
from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.frontend.pending_observations import MAX_ADDED_VARIANCE, ObservationGroup
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import step_variances
from tests.helpers.poses import keyframe_at, pose_at
from tests.logs.examples import random_covariance

PRECISE = OdometryCalibration(
    translation_sigma=1e-4, yaw_sigma=1e-5, min_translation_sigma_m=1e-4, min_rotation_sigma_rad=1e-5
)


def keyframe(number: int, *, segment: int = 0) -> Keyframe:
    T = pose_at(2.0 * number, 0.5 * number, yaw=0.3 * number)
    made = keyframe_at(T, number, travel_m=2.1 * number, segment=segment)
    return replace(made, T_local_body=local_pose(number))


def observation(number: int, landmark: int, rng: np.random.Generator, inflation: float = 1.0) -> Observation:
    return Observation(number, landmark, rng.normal(size=3) * 5.0, random_covariance(rng, 3), inflation)


def local_pose(number: int) -> FloatArray:
    """Where the landmarks have a keyframe: elsewhere than the odometry."""
    return pose_at(1.9 * number, 0.6 * number, yaw=0.28 * number)


def group_of(observations: list[list[Observation]], config: OdometryCalibration = PRECISE) -> ObservationGroup:
    group = ObservationGroup(config)
    for number, seen in enumerate(observations):
        group.add(keyframe(number), seen)
    return group


def random_observations(rng: np.random.Generator, inflation: float = 1.0) -> list[list[Observation]]:
    return [
        [observation(number, landmark, rng, inflation) for landmark in range(4) if rng.random() < 0.7]
        for number in range(4)
    ]


def least_squares(observations: list[Observation]) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance in the frame of keyframe 3, from all normal equations one by one."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    T_last = np.linalg.inv(local_pose(3))
    for each in observations:
        T = T_last @ local_pose(each.keyframe)
        weight = np.linalg.inv(T[:3, :3] @ each.covariance @ T[:3, :3].T * each.covariance_inflation)
        normal += weight
        right += weight @ (T @ np.append(each.position, 1.0))[:3]
    return np.asarray(np.linalg.solve(normal, right)), np.asarray(np.linalg.inv(normal))


def test_the_sum_is_that_of_least_squares_from_where_the_landmarks_have_the_keyframes():
    observations = random_observations(np.random.default_rng(0))
    found = {each.landmark: each for each in group_of(observations).take()}
    everything = [each for seen in observations for each in seen]
    assert set(found) == {each.landmark for each in everything}
    for landmark, sum_ in found.items():
        position, covariance = least_squares([each for each in everything if each.landmark == landmark])
        assert sum_.keyframe == 3
        np.testing.assert_allclose(sum_.position, position, atol=1e-9)
        np.testing.assert_allclose(sum_.covariance * sum_.covariance_inflation, covariance, atol=1e-9)


def test_the_inflation_is_divided_so_that_the_robust_kernel_stays_as_wide():
    observations = random_observations(np.random.default_rng(1), inflation=8.0)
    counts = np.bincount([each.landmark for seen in observations for each in seen])
    found = group_of(observations).take()
    expected = [8.0 / counts[each.landmark] for each in found]
    assert [each.covariance_inflation for each in found] == pytest.approx(expected)


def test_a_group_of_one_keyframe_is_handed_out_as_it_is():
    observations = random_observations(np.random.default_rng(2))[:1]
    group = group_of(observations)
    assert group.take() == observations[0]
    assert group.take() == []


def test_the_next_group_begins_empty():
    rng = np.random.default_rng(3)
    group = group_of(random_observations(rng))
    group.take()
    later = observation(4, 9, rng)
    group.add(keyframe(4), [later])
    assert group.take() == [later]


def test_a_last_keyframe_that_saw_nothing_is_the_frame_all_the_same():
    seen = [observation(0, 1, np.random.default_rng(4))]
    (found,) = group_of([seen, []]).take()
    assert found.keyframe == 1
    assert np.linalg.norm(found.position - seen[0].position) > 0.5


def test_a_group_ends_where_the_motion_would_add_too_much_variance():
    config = OdometryCalibration(translation_sigma=0.1, yaw_sigma=0.02)
    translation, _, heading = 2.0 * step_variances(keyframe(0).odometry, keyframe(1).odometry, config)
    added_m2 = translation + heading * 100.0
    for share, ends in ((0.9, False), (1.1, True)):
        variance = added_m2 / (share * MAX_ADDED_VARIANCE)
        seen = Observation(0, 1, np.array([10.0, 0.0, 0.0]), np.eye(3) * variance / 4.0, 4.0)
        group = group_of([[seen], []], config)
        assert group.ends_before(keyframe(2)) == ends
        assert not group_of([[seen]], config).ends_before(keyframe(1))


def test_a_group_ends_where_the_odometry_breaks():
    for seen in ([observation(0, 1, np.random.default_rng(5))], []):
        group = group_of([seen])
        assert not group.ends_before(keyframe(1))
        assert group.ends_before(keyframe(1, segment=1))


def test_no_group_ends_where_none_began():
    assert not ObservationGroup(PRECISE).ends_before(keyframe(1))
