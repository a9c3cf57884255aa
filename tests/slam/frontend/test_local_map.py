"""The planar EKF-SLAM around the robot: against a textbook's filter with numerical Jacobians, and against truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from slam.common.arrays import FloatArray
from slam.common.geometry import transform_from_xyz_yaw
from slam.frontend import local_map
from slam.frontend.local_map import POSE, LocalMap, _pose_jacobians, upright_step

LANDMARKS = np.array([[8.0, 5.0], [12.0, -6.0], [20.0, 7.0], [28.0, -4.0], [3.0, -9.0]])
STEP_VARIANCES = np.array([0.02**2, 0.004**2])
R_BODY = np.diag([0.05**2, 0.09**2])


def rotation(angle_rad: float) -> FloatArray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def wrapped(angle_rad: float) -> float:
    return float((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


def step(x: float, y: float, yaw: float) -> FloatArray:
    return transform_from_xyz_yaw(np.array([x, y, 0.0]), yaw)


def numerical_jacobian(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    columns = []
    for i in range(len(at)):
        h = np.zeros(len(at))
        h[i] = 1e-6
        columns.append((function(at + h) - function(at - h)) / 2e-6)
    return np.stack(columns, axis=1)


def moved(pose: FloatArray, u: FloatArray) -> FloatArray:
    return np.array([*(pose[:2] + rotation(pose[2]) @ u[:2]), pose[2] + u[2]])


class TextbookFilter:
    """EKF-SLAM with dense matrices and numerical Jacobians (Thrun et al. 2005, 10.2), measurements in the body frame.

    Bearing and range are replaced by the offset of the landmark in the body frame. Positions at which it is linearised
    are first estimates (Huang et al. 2010): ``first``, the predicted one of the body before those of the landmarks.
    """

    def __init__(self) -> None:
        self.x, self.P = np.zeros(3), np.zeros((3, 3))
        self.first = np.zeros(2)

    def linearised_at(self) -> FloatArray:
        return np.concatenate([self.first[:2], self.x[2:3], self.first[2:]])

    def advance(self, u: FloatArray, variances: FloatArray) -> None:
        def motion(x: FloatArray) -> FloatArray:
            return np.concatenate([moved(x[:3], u), x[3:]])

        F = numerical_jacobian(motion, self.x)
        after = motion(self.x)[:2]
        F[:2, 2] = rotation(np.pi / 2.0) @ (after - self.first[:2])
        self.first[:2] = after
        Q = np.zeros_like(self.P)
        Q[:3, :3] = np.diag([variances[0], variances[0], variances[1]])
        self.x, self.P = motion(self.x), F @ self.P @ F.T + Q

    def expected(self, x: FloatArray, slots: list[int]) -> FloatArray:
        places = [x[3 + 2 * slot : 5 + 2 * slot] for slot in slots]
        return np.concatenate([rotation(x[2]).T @ (place - x[:2]) for place in places])

    def update(self, slots: list[int], z: FloatArray, R: FloatArray) -> None:
        H = numerical_jacobian(lambda x: self.expected(x, slots), self.linearised_at())
        S = H @ self.P @ H.T + np.kron(np.eye(len(slots)), R)
        K = self.P @ H.T @ np.linalg.inv(S)
        self.x = self.x + K @ (z.ravel() - self.expected(self.x, slots))
        I_KH = np.eye(len(self.x)) - K @ H
        self.P = I_KH @ self.P @ I_KH.T + K @ np.kron(np.eye(len(slots)), R) @ K.T

    def insert(self, z: FloatArray, R: FloatArray) -> None:
        for each in z:

            def grown(x: FloatArray, each: FloatArray = each) -> FloatArray:
                return np.concatenate([x, x[:2] + rotation(x[2]) @ each])

            G = numerical_jacobian(grown, self.x)
            G_z = np.concatenate([np.zeros((len(self.x), 2)), rotation(self.x[2])])
            place = grown(self.x)[-2:]
            G[-2:, 2] = rotation(np.pi / 2.0) @ (place - self.first[:2])
            self.first = np.concatenate([self.first, place])
            self.x, self.P = grown(self.x), G @ self.P @ G.T + G_z @ R @ G_z.T


def heading_of(local: LocalMap) -> float:
    return float(local._pose[2])


def in_local_axes(local: LocalMap, z: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Measurements (K, 2) of the body frame with one covariance (2, 2), as the local map takes them."""
    T = rotation(heading_of(local))
    return z @ T.T, np.tile(T @ R @ T.T, (len(z), 1, 1))


class Drive:
    """A true drive around ``LANDMARKS`` and what odometry and sensor make of it."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.true = np.zeros(3)

    def advance(self, i: int) -> FloatArray:
        """A step (3,) of the odometry; the true pose moves on by another."""
        u = np.array([0.8, 0.0, 0.12 * np.sin(i / 5.0)])
        self.true = moved(self.true, u)
        noise = self.rng.normal(size=3) * np.sqrt(STEP_VARIANCES[[0, 0, 1]])
        # The filter adds the noise of a step behind it, in local axes.
        self.true = self.true + noise
        return u

    def see(self, slots: list[int]) -> FloatArray:
        """Measurements (K, 2) of landmarks, body frame."""
        z = (LANDMARKS[slots] - self.true[:2]) @ rotation(self.true[2])
        return z + self.rng.multivariate_normal(np.zeros(2), R_BODY, len(slots))


def test_measurements_tell_nothing_of_where_the_frame_lies() -> None:
    local = LocalMap()
    local.advance(step(0.0, 0.0, 0.0), np.array([0.0, 0.3**2]))  # the heading in the frame is hardly known
    drive = Drive(3)
    local.insert(np.arange(5), *in_local_axes(local, drive.see([0, 1, 2, 3, 4]), R_BODY))
    for i in range(60):
        local.advance(step(*drive.advance(i)), STEP_VARIANCES)
        local.update(np.arange(5), *in_local_axes(local, drive.see([0, 1, 2, 3, 4]), R_BODY))
    assert local.pose_covariance[2, 2] >= 0.3**2


def driven(seed: int, steps: int = 30) -> tuple[Drive, LocalMap]:
    """A drive with the landmarks inserted at step 3 and about half of them seen in each scan."""
    drive, local = Drive(seed), LocalMap()
    for i in range(steps):
        local.advance(step(*drive.advance(i)), STEP_VARIANCES)
        if i == 3:
            local.insert(np.arange(5), *in_local_axes(local, drive.see([0, 1, 2, 3, 4]), R_BODY))
        elif i > 3:
            slots = np.flatnonzero(drive.rng.random(5) < 0.5)
            local.update(slots, *in_local_axes(local, drive.see(slots.tolist()), R_BODY))
    return drive, local


def state_of(local: LocalMap) -> FloatArray:
    return np.concatenate([local._pose, local.positions().ravel()])


def assert_is_covariance(P: FloatArray) -> None:
    np.testing.assert_allclose(P, P.T, rtol=1e-12, atol=1e-15)
    values = np.linalg.eigvalsh(P)
    assert values[0] > -1e-12 * values[-1]


# Against the textbook


def test_the_jacobian_by_the_pose_is_the_numerical_one():
    """Of the offset of a landmark, turned by the heading that the filter has, by the pose."""
    for heading in (0.0, 0.7, -2.5):
        pose = np.array([1.5, -2.0, heading])

        def seen(x: FloatArray, heading: float = heading) -> FloatArray:
            return np.concatenate([rotation(heading) @ rotation(x[2]).T @ (each - x[:2]) for each in LANDMARKS])

        found = _pose_jacobians(LANDMARKS - pose[:2]).reshape(-1, POSE)
        np.testing.assert_allclose(found, numerical_jacobian(seen, pose), atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_the_filter_is_the_textbooks(seed, monkeypatch):
    monkeypatch.setattr(local_map, "GATE", np.inf)
    drive, local, textbook = Drive(seed), LocalMap(), TextbookFilter()
    for i in range(25):
        u = drive.advance(i)
        local.advance(step(*u), STEP_VARIANCES)
        textbook.advance(u, STEP_VARIANCES)
        if i in (2, 9):
            z = drive.see([0, 1] if i == 2 else [2, 3, 4])
            local.insert(np.arange(len(z)) + 2 * (i == 9), *in_local_axes(local, z, R_BODY))
            textbook.insert(z, R_BODY)
        elif i > 2:
            slots = [int(slot) for slot in drive.rng.permutation(2 if i < 9 else 5)[:3]]
            z = drive.see(slots)
            local.update(np.array(slots), *in_local_axes(local, z, R_BODY))
            textbook.update(slots, z, R_BODY)
        np.testing.assert_allclose(state_of(local), textbook.x, atol=1e-6)
        np.testing.assert_allclose(local._P, textbook.P, atol=1e-8)


def test_what_is_predicted_is_what_the_textbook_expects_of_a_measurement():
    _, local = driven(0)
    textbook = TextbookFilter()
    textbook.x, textbook.P = state_of(local), local._P
    textbook.first = np.concatenate([local._predicted, local._first.ravel()])
    positions, covariances = local.predict(np.array([3, 1]))
    turn = rotation(heading_of(local))
    for slot, position, covariance in zip([3, 1], positions, covariances, strict=True):
        H = numerical_jacobian(lambda x, slot=slot: textbook.expected(x, [slot]), textbook.linearised_at())
        np.testing.assert_allclose(covariance, turn @ H @ local._P @ H.T @ turn.T, atol=1e-9)
        np.testing.assert_allclose(position - local._pose[:2], turn @ textbook.expected(textbook.x, [slot]), atol=1e-12)


# Against truth


def test_errors_are_as_large_as_the_filter_says():
    """Squared errors in units of the covariance (NEES) over 50 drives, between the 0.05 % and 99.95 % quantiles."""
    runs = 50
    of_all, of_pose, of_offsets = [], [], []
    for seed in range(runs):
        drive, local = driven(seed)
        error = state_of(local) - np.concatenate([drive.true, LANDMARKS.ravel()])
        error[2] = wrapped(error[2])
        of_all.append(error @ np.linalg.solve(local._P, error))
        of_pose.append(error[:3] @ np.linalg.solve(local.pose_covariance, error[:3]))
        positions, covariances = local.predict(np.array([4]))
        true_offset = rotation(heading_of(local) - drive.true[2]) @ (LANDMARKS[4] - drive.true[:2])
        off = positions[0] - local._pose[:2] - true_offset
        of_offsets.append(off @ np.linalg.solve(covariances[0], off))
    for values, freedom in ((of_all, 13), (of_pose, 3), (of_offsets, 2)):
        low, high = chi2.ppf([0.0005, 0.9995], runs * freedom)
        assert low < np.sum(values) < high


def test_landmarks_in_sight_make_the_pose_better_than_the_odometry_alone():
    errors = np.zeros((20, 2))
    for seed in range(20):
        drive, local = driven(seed, steps=40)
        alone, again = Drive(seed), np.zeros(3)
        for i in range(40):
            again = moved(again, alone.advance(i))
        errors[seed] = np.linalg.norm(local._pose[:2] - drive.true[:2]), np.linalg.norm(again[:2] - alone.true[:2])
    assert np.median(errors[:, 0]) < 0.5 * np.median(errors[:, 1])


def seen_again_after_a_wrong_turn(variances: FloatArray) -> tuple[LocalMap, FloatArray]:
    """Landmark 1 is taken in after a turn that the odometry got wrong by 0.1 rad; then only landmark 0 is seen.

    Returns the local map and where landmark 1 was before that.
    """
    local, exact = LocalMap(), 1e-6 * np.eye(2)
    local.insert(np.array([0]), np.array([[10.0, 0.0]]), exact[None])
    local.advance(step(0.0, 0.0, 0.4), variances)
    true_turn = rotation(0.5)
    z = np.array([[10.0, 0.0], [0.0, 20.0]]) @ true_turn
    offsets, covariances = in_local_axes(local, z, exact)
    local.insert(np.array([1]), offsets[1:], covariances[1:])
    before = local.positions()[1]
    local.update(np.array([0]), offsets[:1], covariances[:1])
    return local, before


def test_a_landmark_out_of_sight_follows_the_corrections_of_those_in_sight():
    local, before = seen_again_after_a_wrong_turn(np.array([1e-6, 0.01]))
    assert np.linalg.norm(before - [0.0, 20.0]) > 1.9
    np.testing.assert_allclose(local.positions()[1], [0.0, 20.0], atol=0.11)
    assert heading_of(local) == pytest.approx(0.5, abs=1e-3)


def test_twin_where_the_turn_is_held_to_be_exact_nothing_follows():
    local, before = seen_again_after_a_wrong_turn(np.array([1e-6, 1e-12]))
    np.testing.assert_allclose(local.positions()[1], before, atol=1e-2)


def test_how_uncertain_a_landmark_out_of_sight_is_depends_on_those_in_sight():
    """Both drives are as long; in one of them a second landmark stays in sight."""
    sigmas = []
    for keeps_sight in (True, False):
        local = LocalMap()
        local.insert(np.array([0, 1]), np.array([[5.0, 5.0], [60.0, -8.0]]), np.tile(1e-4 * np.eye(2), (2, 1, 1)))
        for _ in range(50):
            local.advance(step(1.0, 0.0, 0.0), np.array([0.05**2, 1e-8]))
            if keeps_sight:
                offset = local.positions()[1:] - local._pose[:2]
                local.update(np.array([1]), offset, np.array([1e-4 * np.eye(2)]))
        covariance = local.predict(np.array([0]))[1][0]
        sigmas.append(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    assert sigmas[0] < 0.2 * sigmas[1]


@pytest.mark.parametrize("off_m", [3.0, 30.0])
def test_a_measurement_far_off_moves_the_robot_little(off_m):
    _, local = driven(1)
    before = local._pose.copy()
    sigma_m = np.sqrt(np.trace(local.pose_covariance[:2, :2]))
    offsets = local.positions()[[0]] - local._pose[:2] + np.array([[off_m, 0.0]])
    local.update(np.array([0]), offsets, np.array([0.05**2 * np.eye(2)]))
    assert np.linalg.norm(local._pose[:2] - before[:2]) < sigma_m


# Life of the landmarks


@pytest.mark.parametrize("seed", range(5))
def test_whatever_is_done_the_covariance_stays_symmetric_and_positive(seed):
    rng, local, next_id = np.random.default_rng(seed), LocalMap(), 0
    for _ in range(150):
        local.advance(step(*rng.normal(scale=[0.5, 0.1, 0.1])), rng.uniform(0.0, 0.01, 2))
        action, count = rng.integers(4), len(local.ids)
        if action == 0 or count < 2:
            ids = np.arange(next_id, next_id + 2)
            local.insert(ids, rng.normal(scale=10.0, size=(2, 2)), np.tile(0.01 * np.eye(2), (2, 1, 1)))
            next_id += 2
        elif action == 1:
            slots = rng.permutation(count)[:3]
            offsets = local.positions()[slots] - local._pose[:2] + rng.normal(scale=0.2, size=(len(slots), 2))
            local.update(slots, offsets, np.tile(1e-6 * np.eye(2), (len(slots), 1, 1)))
        elif action == 2:
            local.remove(rng.permutation(local.ids)[:1])
        else:
            kept, dropped = rng.permutation(local.ids)[:2].tolist()
            local.merge(kept, dropped, 100.0)
        assert local._P.shape == (POSE + 2 * len(local.ids),) * 2
        assert_is_covariance(local._P)
        assert np.isfinite(state_of(local)).all()
        assert abs(heading_of(local)) <= np.pi


def test_letting_go_of_landmarks_leaves_all_others_as_they_were():
    _, local = driven(2)
    positions, P = local.positions(), local._P.copy()
    local.remove(np.array([1, 3, 99]))
    assert local.ids.tolist() == [0, 2, 4]
    assert local.slots(np.array([4, 1, 0])).tolist() == [2, -1, 0]
    np.testing.assert_array_equal(local.positions(), positions[[0, 2, 4]])
    kept = [0, 1, 2, 3, 4, 7, 8, 11, 12]
    np.testing.assert_array_equal(local._P, P[np.ix_(kept, kept)])


def test_two_landmarks_that_are_merged_lie_where_their_certainties_put_them():
    local = LocalMap()
    variances = np.array([0.04, 0.01])
    offsets = np.array([[10.0, 0.0], [10.5, 0.2]])
    local.insert(np.array([7, 8]), offsets, variances[:, None, None] * np.eye(2))
    local.merge(7, 8, 0.0)
    assert local.ids.tolist() == [7]
    np.testing.assert_allclose(local.positions(), [(offsets / variances[:, None]).sum(axis=0) / (1 / variances).sum()])
    np.testing.assert_allclose(local._P[3:, 3:], np.eye(2) / (1 / variances).sum())


def test_a_merge_corrects_the_robot_too():
    """The second landmark is the first one, seen with the drift since then: as good as a measurement of the first."""
    merged, measured = LocalMap(), LocalMap()
    for local in (merged, measured):
        local.insert(np.array([0]), np.array([[10.0, 3.0]]), 0.01 * np.eye(2)[None])
        local.advance(step(2.0, 0.0, 0.0), np.array([0.25, 0.01]))
    seen, R = np.array([[8.3, 2.9]]), 0.02 * np.eye(2)
    merged.insert(np.array([1]), seen, R[None])
    merged.merge(0, 1, 0.0)
    measured.update(np.array([0]), seen, R[None])
    np.testing.assert_allclose(state_of(merged), state_of(measured), atol=0.01)
    np.testing.assert_allclose(np.diag(merged._P), np.diag(measured._P), rtol=0.05)


def test_the_difference_of_two_landmarks_has_the_covariance_of_both_and_their_correlation():
    _, local = driven(3)
    difference, covariances = local.difference(np.array([0, 2]), np.array([4, 1]))
    for each, covariance, (a, b) in zip(difference, covariances, [(0, 4), (2, 1)], strict=True):
        D = np.zeros((2, 13))
        D[:, 3 + 2 * a : 5 + 2 * a], D[:, 3 + 2 * b : 5 + 2 * b] = np.eye(2), -np.eye(2)
        np.testing.assert_allclose(each, D @ state_of(local))
        np.testing.assert_allclose(covariance, D @ local._P @ D.T, atol=1e-15)


# The frame


def test_a_difference_varies_at_most_twice_as_much_as_both_landmarks_together():
    _, local = driven(3)
    variances = local.variances()
    blocks = [local._P[row : row + 2, row : row + 2] for row in range(POSE, len(local._P), 2)]
    np.testing.assert_allclose(variances, [np.trace(block) for block in blocks])
    first, second = np.triu_indices(len(local.ids), 1)
    of_differences = np.trace(local.difference(first, second)[1], axis1=1, axis2=2)
    assert (of_differences <= 2.0 * (variances[first] + variances[second])).all()


def test_the_local_frame_puts_the_body_where_the_filter_has_it():
    _, local = driven(4)
    T_odom_body = transform_from_xyz_yaw(np.array([5.0, -3.0, 1.2]), 2.0)
    T_local_body = local.T_local_odom(T_odom_body) @ T_odom_body
    np.testing.assert_allclose(T_local_body[:2, 3], local._pose[:2], atol=1e-12)
    np.testing.assert_allclose(T_local_body[:2, :2], rotation(heading_of(local)), atol=1e-12)
    assert T_local_body[2, 3] == pytest.approx(1.2)


def test_without_landmarks_the_local_frame_is_that_of_the_odometry():
    T = [transform_from_xyz_yaw(np.array([x, 0.3 * x, 0.1 * x]), 0.4 * x) for x in (1.0, 2.0, 4.5)]
    local = LocalMap()
    local.start(T[0])
    for before, after in ((T[0], T[1]), (T[1], T[2])):
        local.advance(upright_step(before, after), STEP_VARIANCES)
    np.testing.assert_allclose(local.T_local_odom(T[2]), np.eye(4), atol=1e-12)


def test_a_new_start_forgets_everything():
    _, local = driven(5)
    local.start(np.eye(4))
    assert len(local.ids) == 0
    np.testing.assert_array_equal(local.pose_covariance, np.zeros((3, 3)))
    local.update(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    local.insert(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    np.testing.assert_array_equal(local.T_local_odom(np.eye(4)), np.eye(4))


def test_an_anchor_changes_nothing_that_can_be_measured():
    _, local = driven(0)
    slots = np.arange(len(local.ids))
    positions, covariances = local.predict(slots)
    first, second = np.triu_indices(len(slots), 1)
    apart = local.difference(first, second)
    local.anchor()
    assert_is_covariance(local._P)
    np.testing.assert_array_equal(local.pose_covariance, np.zeros((3, 3)))
    for before, after in ((positions, local.predict(slots)[0]), (covariances, local.predict(slots)[1])):
        np.testing.assert_allclose(after, before, atol=1e-12)
    np.testing.assert_allclose(local.difference(first, second)[0], apart[0], atol=1e-12)


def test_what_is_kept_of_the_filter_is_known_to_be_out_of_date():
    local = LocalMap()
    local.insert(np.array([4, 7]), np.array([[5.0, 1.0], [5.1, 1.0]]), np.tile(0.01 * np.eye(2), (2, 1, 1)))
    changes = {
        "advance": lambda: local.advance(step(0.0, 0.0, 0.0), STEP_VARIANCES),
        "update": lambda: local.update(np.array([0]), np.array([[5.0, 1.0]]), 0.01 * np.eye(2)[None]),
        "anchor": local.anchor,
        "insert": lambda: local.insert(np.array([8]), np.array([[9.0, 1.0]]), 0.01 * np.eye(2)[None]),
        "merge": lambda: local.merge(4, 7, 0.01),
        "remove": lambda: local.remove(np.array([8])),
    }
    for name, change in changes.items():
        pose, ids = local.pose, local.ids
        change()
        assert local.pose is not pose or local.ids is not ids, name
