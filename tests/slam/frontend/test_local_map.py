"""The invariant EKF: against least squares over the whole drive, against dense formulas, and against truth."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert, make_transform, relative, skew
from slam.frontend.local_map import POSE, LocalMap
from tests.helpers.poses import motion_by, pose_at

LANDMARKS = np.array([[8.0, 5.0, 1.0], [12.0, -6.0, -2.0], [20.0, 7.0, 0.5], [28.0, -4.0, 3.0], [3.0, -9.0, 0.0]])
ALL = np.arange(len(LANDMARKS))
Q = np.diag(np.repeat([0.004**2, 0.02**2], 3))
"""Of a step: rotation, then translation, axes of the body."""
R_BODY = np.diag([0.05, 0.09, 0.03]) ** 2
PLANAR, SPATIAL = [0.0, 0.0, 0.3], [0.3, 0.2, 0.3]
UPSIDE_DOWN = make_transform(Rotation.from_euler("xz", [np.pi, 0.4]).as_matrix(), np.array([3.0, -2.0, 5.0]))
FAR_AWAY = pose_at(8000.0, -3000.0, z=100.0)


@dataclass
class Measurement:
    """Offsets ``z`` (K, 3) m of landmarks ``ids`` (K,) in the axes of the body at a step."""

    step: int
    ids: IntArray
    z: FloatArray


class Drive:
    """A drive around ``LANDMARKS`` whose odometry and measurements have ``scale`` times the noise of Q and R_BODY."""

    def __init__(self, seed: int, turns: list[float] = SPATIAL, *, steps: int = 8, scale: float = 1.0) -> None:
        rng = np.random.default_rng(seed)
        self.Q, self.R = scale**2 * Q, scale**2 * R_BODY
        self.T_true, self.odometry, self.seen = np.eye(4), list[FloatArray](), list[Measurement]()
        for step in range(steps):
            turn = turns * rng.normal(size=3)
            U = motion_by(turn, rng.uniform(-0.5, 1.5, 3) * (np.array(turns) > 0)[[2, 2, 0]])
            noise = rng.normal(size=POSE) * np.sqrt(np.diag(self.Q))
            self.T_true = self.T_true @ U @ motion_by(noise[:3], noise[3:])
            self.odometry.append(U)
            ids = ALL if step == 1 else np.flatnonzero(rng.random(len(ALL)) < 0.6)
            z = (LANDMARKS[ids] - self.T_true[:3, 3]) @ self.T_true[:3, :3]
            if step > 0:
                self.seen.append(Measurement(step, ids, z + rng.normal(size=z.shape) * np.sqrt(np.diag(self.R))))

    def filtered(self, T_start: FloatArray | None = None, P_start: FloatArray | None = None) -> LocalMap:
        """The local map after the drive; all landmarks are inserted by the first measurement."""
        local = LocalMap()
        local.start(np.eye(4) if T_start is None else T_start)
        local.advance(np.eye(4), np.zeros((POSE, POSE)) if P_start is None else P_start)
        measurements = {each.step: each for each in self.seen}
        for step, U in enumerate(self.odometry):
            local.advance(U, self.Q)
            if step in measurements:
                observe(local, measurements[step], self.R)
        return local

    def residuals(self, x: FloatArray) -> FloatArray:
        """Whitened, of poses as (rotation vector, position) each, and landmarks."""
        poses, landmarks = np.split(x, [POSE * len(self.odometry)])
        poses, landmarks = poses.reshape(-1, POSE), landmarks.reshape(-1, 3)
        T = np.concatenate([np.eye(4)[None], motion_by(poses[:, :3], poses[:, 3:])])
        of_steps = []
        for before, after, U in zip(T[:-1], T[1:], self.odometry, strict=True):
            off = relative(before @ U, after)
            of_steps.append([*Rotation.from_matrix(off[:3, :3]).as_rotvec(), *off[:3, 3]])
        found = [np.array(of_steps) / np.sqrt(np.diag(self.Q))]
        for each in self.seen:
            at = T[each.step + 1]
            found.append((each.z - (landmarks[each.ids] - at[:3, 3]) @ at[:3, :3]) / np.sqrt(np.diag(self.R)))
        return np.concatenate([each.ravel() for each in found])


def observe(local: LocalMap, seen: Measurement, R_body: FloatArray) -> None:
    """Update landmarks by a measurement; insert those that are not held."""
    R = local.T_local_body[:3, :3]
    offsets, covariances = seen.z @ R.T, np.tile(R @ R_body @ R.T, (len(seen.z), 1, 1))
    known = np.isin(seen.ids, local.ids)
    if known.any():
        shared, none = np.zeros((known.sum(), 3)), np.zeros((3 * known.sum(), 0))
        local.update(local.slots(seen.ids[known]), offsets[known], covariances[known], shared, none)
    local.insert(seen.ids[~known], offsets[~known], covariances[~known])


def error_of(local: LocalMap, T: FloatArray, landmarks: FloatArray) -> FloatArray:
    """The right-invariant error of the estimate where pose and landmarks are these."""
    R = T[:3, :3] @ local.T_local_body[:3, :3].T
    positions = [T[:3, 3] - R @ local.T_local_body[:3, 3], *(landmarks - local.positions @ R.T)]
    return np.concatenate([Rotation.from_matrix(R).as_rotvec(), *positions])


# Against least squares


@pytest.mark.parametrize("turns", [PLANAR, SPATIAL], ids=["planar", "spatial"])
@pytest.mark.parametrize("seed", range(3))
def test_filter_agrees_with_least_squares_over_all_poses(seed: int, turns: list[float]) -> None:
    """Noise is small, so that both are linear."""
    drive = Drive(seed, turns, steps=6, scale=0.01)
    local = drive.filtered()
    count = len(drive.odometry)
    T, start = np.eye(4), []
    for U in drive.odometry:
        T = T @ U
        start.append([*Rotation.from_matrix(T[:3, :3]).as_rotvec(), *T[:3, 3]])
    solved = least_squares(drive.residuals, np.concatenate([np.ravel(start), LANDMARKS.ravel()]), method="lm")
    last = slice(POSE * (count - 1), POSE * count)
    T_solved = motion_by(solved.x[last][:3], solved.x[last][3:])
    landmarks = solved.x[POSE * count :].reshape(-1, 3)
    off = error_of(local, T_solved, landmarks)
    assert off @ np.linalg.solve(local._P, off) < 0.01

    def by_error(xi: FloatArray) -> FloatArray:
        """The unknowns of least squares, the last pose and the landmarks, where the estimate has that error."""
        R = Rotation.from_rotvec(xi[:3])
        at = R * Rotation.from_matrix(local.T_local_body[:3, :3])
        positions = R.apply(np.vstack([local.T_local_body[:3, 3], local.positions])) + xi[3:].reshape(-1, 3)
        return np.concatenate([at.as_rotvec(), positions.ravel()])

    J = np.stack([(by_error(h) - by_error(-h)) / 2e-6 for h in 1e-6 * np.eye(len(off))], axis=1)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)[POSE * (count - 1) :, POSE * (count - 1) :]
    expected = J @ local._P @ J.T
    sigmas = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(covariance / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=0.02)


# The frame


@pytest.mark.parametrize("seed", range(3))
def test_measurements_tell_nothing_about_the_frame(seed: int) -> None:
    """An unknown motion of the whole frame stays as unknown, and changes no estimate."""
    drive = Drive(seed, steps=15)
    P_start = np.diag([0.5, 0.3, 0.4, 9.0, 4.0, 1.0]) ** 2
    known, unknown = drive.filtered(), drive.filtered(P_start=P_start)
    np.testing.assert_allclose(unknown.T_local_body, known.T_local_body, atol=1e-9)
    np.testing.assert_allclose(unknown.positions, known.positions, atol=1e-9)
    N = np.vstack([np.eye(POSE), np.tile(np.eye(POSE)[3:], (len(ALL), 1))])
    np.testing.assert_allclose(unknown._P, known._P + N @ P_start @ N.T, atol=1e-9)


@pytest.mark.parametrize("T_start", [UPSIDE_DOWN, FAR_AWAY], ids=["upside down", "far away"])
def test_start_of_the_drive_does_not_matter(T_start: FloatArray) -> None:
    drive = Drive(0, steps=15)
    here, there = drive.filtered(), drive.filtered(T_start)
    np.testing.assert_allclose(there.T_local_body, T_start @ here.T_local_body, atol=1e-6)
    np.testing.assert_allclose(there.positions, here.positions @ T_start[:3, :3].T + T_start[:3, 3], atol=1e-6)
    R = np.kron(np.eye(len(ALL)), T_start[:3, :3])
    np.testing.assert_allclose(there.relative_covariance(ALL), R @ here.relative_covariance(ALL) @ R.T, atol=1e-6)


# Single steps


def test_effects_of_a_step_are_how_its_error_moves_the_offsets_of_landmarks() -> None:
    local = Drive(3).filtered()
    T, landmarks = local.T_local_body, local.positions

    def measured(error: FloatArray) -> FloatArray:
        """Offsets that a body measures whose step had the error, in the axes that the filter believes in."""
        turn = pose_at(yaw=error[0])[:3, :3]
        T_true = make_transform(turn @ T[:3, :3], T[:3, 3] + np.append(error[1:], 0.0))
        return np.asarray((apply(invert(T_true), landmarks) @ T[:3, :3].T).ravel())

    effects = local.step_effects(np.arange(len(local.ids)))
    for axis, error in enumerate(1e-6 * np.eye(3)):
        np.testing.assert_allclose(effects[:, axis], 1e6 * (measured(error) - measured(np.zeros(3))), atol=1e-4)


def test_update_whitens_the_innovation_and_effects_on_it() -> None:
    """The innovation has the squared distance by its covariance; effects equal to it are whitened alike."""
    local = Drive(4).filtered()
    slots, R = np.array([0, 2]), np.tile(0.3**2 * np.eye(3), (2, 1, 1))
    shared = np.array([[0.1, 0.2, 0.0], [-0.2, 0.3, 0.0]])
    joint = local.relative_covariance(slots) + np.kron(np.eye(2), R[0]) + np.outer(shared, shared)
    innovation = 0.1 * np.array([1.0, -1.0, 0.5, -0.5, 1.0, 0.2])
    measured = local.positions[slots] - local.T_local_body[:3, 3] + innovation.reshape(2, 3)
    covariances = R + np.einsum("ki,kj->kij", shared, shared)
    whitened, effects = local.update(
        slots, measured, covariances, shared, np.column_stack([innovation, 2.0 * innovation])
    )
    assert whitened @ whitened == pytest.approx(innovation @ np.linalg.solve(joint, innovation))
    np.testing.assert_allclose(effects, np.column_stack([whitened, 2.0 * whitened]))


@pytest.mark.parametrize("off_m", [3.0, 30.0])
def test_measurement_far_off_moves_the_robot_little(off_m: float) -> None:
    local = Drive(1).filtered()
    before, sigma_m = local.T_local_body[:3, 3], np.sqrt(np.trace(local._P[3:POSE, 3:POSE]))
    offsets = local.positions[[0]] - before + np.array([[off_m, 0.0, 0.0]])
    local.update(np.array([0]), offsets, 0.05**2 * np.eye(3)[None], np.zeros((1, 3)), np.zeros((3, 0)))
    assert np.linalg.norm(local.T_local_body[:3, 3] - before) < sigma_m


def test_update_of_landmarks_alone_changes_nothing_else() -> None:
    """Against Schmidt's filter in dense matrices."""
    local = Drive(2).filtered()
    slots = np.array([1, 3])
    T, positions, P = local.T_local_body, local.positions, local._P.copy()
    R = 0.04 * np.eye(3)
    innovations = np.array([[0.1, -0.2, 0.05], [0.3, 0.0, -0.1]])
    local.update_landmarks(slots, positions[slots] - T[:3, 3] + innovations, np.tile(R, (2, 1, 1)))

    H, K = np.zeros((6, len(P))), np.zeros((len(P), 6))
    for row, slot in enumerate(slots.tolist()):
        rows, columns = slice(3 * row, 3 * row + 3), slice(POSE + 3 * slot, POSE + 3 * slot + 3)
        H[rows, columns], H[rows, 3:POSE] = np.eye(3), -np.eye(3)
        K[columns, rows] = (P @ H[rows].T @ np.linalg.inv(H[rows] @ P @ H[rows].T + R))[columns]
    I_KH = np.eye(len(P)) - K @ H
    np.testing.assert_allclose(local._P, I_KH @ P @ I_KH.T + K @ block_diag(R, R) @ K.T, atol=1e-12)
    np.testing.assert_array_equal(local.T_local_body, T)
    moved = (K @ innovations.ravel())[POSE:].reshape(-1, 3)
    np.testing.assert_allclose(local.positions, positions + moved, atol=1e-12)


def test_update_of_landmarks_alone_leaves_no_asymmetry_that_would_grow() -> None:
    local = Drive(3).filtered(P_start=np.diag(np.repeat([0.04, 400.0], 3)))
    slots = local.slots(ALL)
    offsets = local.positions[slots] - local.T_local_body[:3, 3]
    local.update_landmarks(slots, offsets, np.tile(R_BODY, (len(ALL), 1, 1)))
    np.testing.assert_array_equal(local._P[POSE:], local._P[:, POSE:].T)


def test_shift_moves_the_body_and_makes_its_pose_less_certain() -> None:
    local = Drive(3).filtered(UPSIDE_DOWN)
    T, positions = local.T_local_body, local.positions
    own, before = local._P[POSE:, POSE:].copy(), local.relative_covariance(ALL)
    added = np.diag([0.02, 0.01, 0.3, 0.5, 0.4, 0.1]) ** 2
    T_shift = pose_at(1.0, -2.0, yaw=0.5)
    local.shift(T_shift, added)
    np.testing.assert_allclose(local.T_local_body, T_shift @ T)
    np.testing.assert_array_equal(local.positions, positions)
    # The offset of a landmark errs by the turn of the body about itself and by its shift.
    offsets = positions - local.T_local_body[:3, 3]
    A = np.concatenate([np.hstack([skew(each), -np.eye(3)]) for each in offsets])
    np.testing.assert_allclose(local.relative_covariance(ALL), before + A @ added @ A.T, atol=1e-9)
    assert not np.allclose(local._P[POSE:, POSE:], own)


def test_moved_landmark_is_less_certain() -> None:
    local = Drive(3).filtered()
    positions, P = local.positions, local._P.copy()
    local.move(np.array([2]), np.array([[1.0, 2.0, 0.0]]), np.array([0.25]))
    np.testing.assert_array_equal(local.positions[2], positions[2] + [1.0, 2.0, 0.0])
    added = local._P - P
    np.testing.assert_allclose(added[12:15, 12:15], 0.25 * np.eye(3), atol=1e-12)
    assert np.count_nonzero(added) == 3


def test_removal_marginalizes() -> None:
    local = Drive(2).filtered()
    positions, P = local.positions, local._P.copy()
    local.remove(np.array([1, 3, 99]))
    assert local.ids.tolist() == [0, 2, 4]
    assert local.slots(np.array([4, 0])).tolist() == [2, 0]
    np.testing.assert_array_equal(local.positions, positions[[0, 2, 4]])
    kept = np.concatenate([np.arange(POSE + 3), np.arange(12, 15), np.arange(18, 21)])
    np.testing.assert_array_equal(local._P, P[np.ix_(kept, kept)])
