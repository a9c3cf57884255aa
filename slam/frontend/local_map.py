"""The landmarks around the robot and the robot among them: an invariant EKF over a bounded number of landmarks.

State: the pose of the body (R, t) and the positions m of the landmarks, in the *local* frame: smooth, and as good as
the odometry corrected by the landmarks in view. So a landmark that was out of sight for a while is expected where the
landmarks that stayed in sight say, and how uncertain that is follows from the correlations (Smith, Self and Cheeseman,
1990; Dissanayake et al., IEEE T-RA 2001).

The error (phi, dt, dm) is right-invariant: R = exp(phi) R_est, t = exp(phi) t_est + V dt, m = exp(phi) m_est + V dm,
with V the left Jacobian of the rotation. Then

* a measured offset R z of a landmark from the body differs from its prediction by dm - dt and noise: the Jacobians
  are -I and I, at any estimate, so the filter gains no information about where its own frame lies, which no
  measurement tells;
* a step of the odometry with an error (n_phi, n_t) in the axes of the body after it adds R n_phi to phi, R n_t to dt,
  and x cross R n_phi to the error of each position x, that of the body included.

Source: Barrau and Bonnabel, An EKF-SLAM algorithm with consistency properties, 2015; Zhang et al., IEEE RA-L 2017.
"""

import numpy as np
from scipy.linalg import solve_triangular

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import (
    covariance_in_axes,
    left_jacobian,
    make_transform,
    rigid,
    rotation_of,
    skew,
    squared_mahalanobis,
)
from slam.odometry.noise_scale import GATE

POSE = 6
"""Entries of the error before the landmarks: rotation, then translation."""


class LocalMap:
    """An EKF over the pose of the body and the landmarks that it holds, each known by an id; later ones have higher
    ids.
    """

    def __init__(self) -> None:
        self.start(np.eye(4))

    def start(self, T_odom_body: FloatArray) -> None:
        """Restart at a pose, without landmarks, as after a discontinuity of the odometry."""
        # Positions inside are relative to the start, so that lever arms stay short wherever the odometry begins.
        self._origin = T_odom_body[:3, 3].copy()
        self._place(make_transform(T_odom_body[:3, :3], np.zeros(3)))
        self._P = np.zeros((POSE, POSE))
        self.ids = np.zeros(0, dtype=np.int64)
        """Ids (L,) of the landmarks held, ascending; another array once they change."""
        self._positions = np.zeros((0, 3))

    @property
    def positions(self) -> FloatArray:
        """Positions (L, 3) m of all landmarks held, local frame."""
        return self._positions + self._origin

    def _place(self, T_start_body: FloatArray) -> None:
        self._T = T_start_body
        self.T_local_body = make_transform(T_start_body[:3, :3], T_start_body[:3, 3] + self._origin)
        """Pose (4, 4) of the body; another array once it changes."""

    def slots(self, ids: IntArray) -> IntArray:
        """Where ids (K,), all of them held, stand in the state."""
        return np.searchsorted(self.ids, ids)

    def advance(self, T_before_after: FloatArray, covariance: FloatArray) -> None:
        """Move the body by a step (4, 4) of the odometry with its covariance (6, 6), rotation [rad] before translation
        [m], in the axes of the body after it.
        """
        self._place(self._T @ T_before_after)
        R = self._T[:3, :3]
        # Jacobian of the error by the noise, with its lever arms to all positions.
        G = np.zeros((len(self._P), POSE))
        G[:3, :3] = G[3:POSE, 3:] = R
        arms = np.concatenate([self._T[None, :3, 3], self._positions])
        G[3:, :3] = (skew(arms) @ R).reshape(-1, 3)
        self._P += G @ covariance @ G.T

    def shift(self, T_correction: FloatArray, covariance: FloatArray) -> None:
        """Move the body by ``T_correction`` (4, 4) of the local frame, and let its pose be less certain by
        ``covariance`` (6, 6), rotation before translation, local axes.
        """
        moved = rigid(T_correction @ self.T_local_body)
        self._T = make_transform(moved[:3, :3], moved[:3, 3] - self._origin)
        self.advance(np.eye(4), covariance_in_axes(covariance, self._T[:3, :3]))

    def predict(self, slots: IntArray) -> tuple[FloatArray, FloatArray]:
        """Positions (K, 3) m of landmarks, and covariances (K, 3, 3) m^2 of their offsets from the body, local axes."""
        columns = _columns(slots)
        own = self._P[_blocks(columns)]
        cross = self._P[3:POSE][:, columns].transpose(1, 0, 2)
        return self._positions[slots] + self._origin, own + self._P[3:POSE, 3:POSE] - cross - cross.transpose(0, 2, 1)

    def relative_covariance(self, slots: IntArray) -> FloatArray:
        """Joint covariance (3 K, 3 K) m^2 of the offsets of landmarks from the body, local axes."""
        columns = _columns(slots).ravel()
        cross = np.tile(self._P[3:POSE][:, columns], (len(slots), 1))
        of_pose = np.tile(self._P[3:POSE, 3:POSE], (len(slots), len(slots)))
        return self._P.take(columns, axis=0).take(columns, axis=1) + of_pose - cross - cross.T

    def step_effects(self, slots: IntArray) -> FloatArray:
        """(3 K, 3): by how much an error of the last step in heading, x and y moves the offsets of landmarks from the
        body, local axes.
        """
        offsets = self._positions[slots] - self._T[:3, 3]
        shifts = np.tile(-np.eye(3, 2), (len(slots), 1, 1))
        return np.concatenate([skew(offsets)[:, :, 2:], shifts], axis=2).reshape(-1, 3)

    def update(
        self, slots: IntArray, measured: FloatArray, covariances: FloatArray, shifts: FloatArray, effects: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Correct the state by landmarks of one scan.

        Args:
            slots: (K,) of the landmarks, one at least, none twice.
            measured: (K, 3) m, offsets from the body in local axes.
            covariances: (K, 3, 3) m^2 of the measurements, in the same axes.
            shifts: (K, 3) m, one standard deviation of an error that they share, part of the covariances.
            effects: (3 K, N) of errors on what was measured.

        Returns:
            The innovations (3 K,) and the effects (3 K, N), whitened by the covariance of the innovations.

        Raises:
            np.linalg.LinAlgError: noises differ by more orders of magnitude than float64 has digits.
        """
        count = len(slots)
        innovations = measured - (self._positions[slots] - self._T[:3, 3])
        columns = _columns(slots).ravel()
        HP = self._P[columns] - np.tile(self._P[3:POSE], (count, 1))
        S = HP[:, columns] - np.tile(HP[:, 3:POSE], (1, count))
        blocks = _blocks(np.arange(3 * count).reshape(count, 3))
        own = S[blocks] + covariances
        S += np.outer(shifts, shifts)
        excess = np.maximum(squared_mahalanobis(innovations, own) / GATE - 1.0, 0.0)  # Huber's weights, beyond the gate
        S[blocks] = own + excess[:, None, None] * covariances
        # One triangular solution for the gain and for what it is applied to.
        known = np.column_stack([HP, innovations.ravel(), effects])
        root = np.linalg.cholesky(S)
        whitened = solve_triangular(root, known, lower=True, check_finite=False, overwrite_b=True)
        size = len(self._P)
        gain, innovation = whitened[:, :size], whitened[:, size]
        self._P -= gain.T @ gain
        change = innovation @ gain
        R, V = rotation_of(change[:3]), left_jacobian(change[:3])
        shifts = change[3:].reshape(-1, 3) @ V.T
        self._place(make_transform(R @ self._T[:3, :3], R @ self._T[:3, 3] + shifts[0]))
        self._positions = self._positions @ R.T + shifts[1:]
        return innovation, whitened[:, size + 1 :]

    def update_landmarks(self, slots: IntArray, measured: FloatArray, covariances: FloatArray) -> None:
        """Correct landmarks by one scan, but not the pose of the body.

        The gains of all else are zero (Schmidt, Advances in Control Systems 3, 1966). Arguments as of ``update``.
        """
        if len(slots) == 0:
            return
        innovations = measured - (self._positions[slots] - self._T[:3, 3])
        columns = _columns(slots)
        blocks = _blocks(columns)
        _, relative = self.predict(slots)
        own = self._P[blocks] - self._P[3:POSE][:, columns].transpose(1, 2, 0)
        gains = np.swapaxes(np.linalg.solve(relative + covariances, own.swapaxes(1, 2)), 1, 2)
        flat = columns.ravel()
        rows = self._P[columns] - self._P[3:POSE]
        self._P[flat] -= (gains @ rows).reshape(len(flat), -1)
        rows = self._P[:, flat].T.reshape(len(slots), 3, -1) - self._P[:, 3:POSE].T
        self._P[:, flat] -= (gains @ rows).reshape(len(flat), -1).T
        self._P[blocks] += gains @ covariances @ gains.swapaxes(1, 2)
        # What rounding makes asymmetric grows from update to update.
        symmetric = 0.5 * (self._P[flat] + self._P[:, flat].T)
        self._P[flat], self._P[:, flat] = symmetric, symmetric.T
        self._positions = self._positions.copy()
        self._positions[slots] += np.einsum("kij,kj->ki", gains, innovations)

    def move(self, slots: IntArray, shifts: FloatArray, variances: FloatArray) -> None:
        """Move landmarks (K,) by ``shifts`` (K, 3) m, whose coordinates err by ``variances`` (K, 3 or 1) m^2."""
        self._positions = self._positions.copy()
        self._positions[slots] += shifts
        columns = _columns(slots)
        self._P[columns, columns] += variances

    def insert(self, ids: IntArray, offsets: FloatArray, covariances: FloatArray) -> None:
        """Add landmarks (K,) at ``offsets`` (K, 3) m from the body in local axes, with covariances (K, 3, 3) m^2."""
        count = len(ids)
        cross = np.tile(self._P[3:POSE], (count, 1))
        own = np.tile(cross[:, 3:POSE], (1, count))
        own[_blocks(np.arange(3 * count).reshape(count, 3))] += covariances
        self._P = np.block([[self._P, cross.T], [cross, own]])
        self._positions = np.concatenate([self._positions, self._T[:3, 3] + offsets])
        self.ids = np.concatenate([self.ids, ids])

    def remove(self, ids: IntArray) -> None:
        """Marginalize landmarks; ids that are not held are ignored."""
        kept = np.flatnonzero(~np.isin(self.ids, ids))
        if len(kept) == len(self.ids):
            return
        columns = np.append(np.arange(POSE), _columns(kept))
        self._P = self._P.take(columns, axis=0).take(columns, axis=1)  # faster than by np.ix_
        self._positions = self._positions[kept]
        self.ids = self.ids[kept]


def _columns(slots: IntArray) -> IntArray:
    """(K, 3): where the positions of landmarks stand in the error."""
    return POSE + 3 * slots[:, None] + np.arange(3)


def _blocks(columns: IntArray) -> tuple[IntArray, IntArray]:
    """Indices of the blocks (K, 3, 3) of a covariance, for the columns (K, 3) of each landmark."""
    return columns[:, :, None], columns[:, None, :]
