"""The landmarks around the robot and the robot among them: a planar EKF-SLAM over a bounded number of landmarks.

State: the robot's pose (x, y, heading) and the landmarks' positions (x, y), with their full covariance, in the *local*
frame: upright, smooth, and as good as the odometry corrected by the landmarks in view. So a landmark that was out of
sight for a while is expected where the landmarks that stayed in sight say, and how uncertain that is follows from the
correlations (Smith, Self and Cheeseman, 1990; Dissanayake et al., IEEE T-RA 2001). Heights, roll and pitch are left to
the odometry, which gravity holds.

A measurement of landmark m from the pose (t, heading) is h = R^T (m - t), with R the rotation by the heading. Its
Jacobians are -R^T and the rotation of h by -90 deg in the pose, R^T in the landmark. They are taken at first estimates:
of a landmark where it was inserted, of the pose as it was predicted. Where the frame itself lies cannot be measured;
with Jacobians at the latest estimates the filter seems to learn it from each measurement and moves the whole map
(first-estimates Jacobian EKF: Huang, Mourikis and Roumeliotis, IJRR 2010).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import invert, transform_from_xyz_yaw, yaw_rad

POSE = 3
"""Entries of the state before the landmarks."""
GATE = 9.21
"""Chi-squared with 2 degrees of freedom at 99 %: a measurement farther off is weighted down by its distance."""


class LocalMap:
    """An EKF over the robot's pose and the landmarks that it holds, each known by an id of the caller's."""

    def __init__(self) -> None:
        self.start(np.eye(4))

    def start(self, T_odom_body: FloatArray) -> None:
        """Begin anew at a pose, without landmarks, as after a discontinuity of the odometry."""
        self._pose = np.array([*T_odom_body[:2, 3], float(yaw_rad(T_odom_body))])
        self._predicted = self._pose[:2].copy()
        self._P = np.zeros((POSE, POSE))
        self._ids = np.zeros(0, dtype=np.int64)
        self._slots: dict[int, int] = {}
        self._positions = np.zeros((0, 2))
        self._first = np.zeros((0, 2))

    @property
    def ids(self) -> IntArray:
        """Ids (L,) of the landmarks held."""
        return self._ids

    @property
    def pose(self) -> FloatArray:
        """The robot's pose (3,), x, y [m] and the heading [rad], local frame; another array once any estimate or
        covariance has changed, but where ``ids`` is another.
        """
        return self._pose

    @property
    def pose_covariance(self) -> FloatArray:
        """Covariance (3, 3) of x, y [m] and the heading [rad], local frame."""
        return self._P[:POSE, :POSE].copy()

    def T_local_odom(self, T_odom_body: FloatArray) -> FloatArray:
        """``T_local_odom`` (4, 4), upright, that puts the body where the filter has it."""
        heading = float(self._pose[2] - yaw_rad(T_odom_body))
        T = transform_from_xyz_yaw(np.zeros(3), heading)
        T[:2, 3] = self._pose[:2] - (T @ T_odom_body)[:2, 3]
        return T

    def slots(self, ids: IntArray) -> IntArray:
        """Where ids (K,) stand in the state; -1 for one that is not held."""
        return np.array([self._slots.get(each, -1) for each in ids.tolist()], dtype=np.int64)

    def advance(self, T_before_after: FloatArray, variances: FloatArray) -> None:
        """Move the robot by a step of the odometry.

        Args:
            T_before_after: (4, 4) between the gravity frames of the body (upright) before and after.
            variances: (2,) of the step: each horizontal coordinate [m^2] and the heading [rad^2].
        """
        from_x, from_y, heading = self._pose.tolist()
        c, s = np.cos(heading), np.sin(heading)
        x, y = T_before_after[:2, 3].tolist()
        turned = _wrapped(heading + float(yaw_rad(T_before_after)))
        self._pose = np.array([from_x + (c * x - s * y), from_y + (s * x + c * y), turned])
        x, y = (self._pose[:2] - self._predicted).tolist()
        self._predicted = self._pose[:2].copy()
        # P becomes F P F^T + Q; F is the identity but for the last entries of its first two rows, -y and x.
        P = self._P
        P[0] -= y * P[2]
        P[1] += x * P[2]
        P[:, 0] -= y * P[:, 2]
        P[:, 1] += x * P[:, 2]
        P[1, 0] = P[0, 1]
        translation, rotation = variances.tolist()
        P[0, 0] += translation
        P[1, 1] += translation
        P[2, 2] += rotation

    def anchor(self) -> None:
        """Hold the robot's pose to be known: all covariances are relative to it from now on.

        No position changes. The frame itself is arbitrary, but the more uncertain the pose is in it, the worse is the
        linearization: the filter gains information about the frame that no measurement holds, and pulls the whole map
        along (Julier and Uhlmann, ICRA 2001; robocentric: Castellanos et al., Robotics and Autonomous Systems 2007).
        """
        G = _pose_jacobians(self._first - self._predicted).reshape(-1, POSE)
        mixed = G @ self._P[:POSE, POSE:]
        P = self._P[POSE:, POSE:] + mixed + mixed.T + G @ self._P[:POSE, :POSE] @ G.T
        self._P = np.zeros_like(self._P)
        self._P[POSE:, POSE:] = 0.5 * (P + P.T)
        self._pose = self._pose.copy()
        self._first, self._predicted = self._positions.copy(), self._pose[:2].copy()

    def predict(self, slots: IntArray) -> tuple[FloatArray, FloatArray]:
        """Positions (K, 2) m and covariances (K, 2, 2) m^2 of landmarks relative to the robot, both in local axes.

        The covariance is that of R h, the offset from the robot: what a measurement of it adds its own noise to.
        """
        G = self._jacobians(slots)
        columns = POSE + 2 * slots[:, None] + np.arange(2)
        P_pose = self._P[:POSE, :POSE]
        P_cross = self._P[:POSE][:, columns].transpose(1, 0, 2)  # (K, 3, 2)
        P_own = self._P[columns[:, :, None], columns[:, None, :]]
        mixed = G @ P_cross
        covariances = G @ P_pose @ G.transpose(0, 2, 1) + mixed + mixed.transpose(0, 2, 1) + P_own
        return self._positions[slots], covariances

    def update(self, slots: IntArray, measured: FloatArray, covariances: FloatArray) -> None:
        """Correct the state by landmarks seen at once.

        Args:
            slots: (K,) of the landmarks, none twice.
            measured: (K, 2) m, offsets from the robot in local axes.
            covariances: (K, 2, 2) m^2 of the measurements, in the same axes.
        """
        count = len(slots)
        if count == 0:
            return
        offsets = self._positions[slots] - self._pose[:2]
        G = self._jacobians(slots)
        columns = (POSE + 2 * slots[:, None] + np.arange(2)).ravel()
        HP = _by_pose(G, self._P[:, :POSE].T) + self._P[:, columns].T
        S = _by_pose(G, HP[:, :POSE].T) + HP[:, columns].T
        innovations = measured - offsets
        entries = np.arange(2 * count).reshape(count, 2)
        blocks = entries[:, :, None], entries[:, None, :]
        own = S[blocks] + covariances
        excess = np.maximum(_squared_distances(innovations, own) / GATE - 1.0, 0.0)  # Huber's weights
        S[blocks] = own + excess[:, None, None] * covariances
        # One triangular solution for the gain and for what it is applied to.
        known = np.column_stack([HP, innovations.ravel()])
        whitened = solve_triangular(np.linalg.cholesky(S), known, lower=True, check_finite=False, overwrite_b=True)
        gain, innovation = whitened[:, :-1], whitened[:, -1]
        self._P -= gain.T @ gain
        self._apply(innovation @ gain)

    def insert(self, ids: IntArray, offsets: FloatArray, covariances: FloatArray) -> None:
        """Take in landmarks (K,) at ``offsets`` (K, 2) m from the robot in local axes, known by (K, 2, 2) m^2."""
        if len(ids) == 0:
            return
        size, count = len(self._P), len(ids)
        positions = self._pose[:2] + offsets
        G = _pose_jacobians(positions - self._predicted)
        G[:, :, :2] *= -1.0  # a landmark moves with the robot that sees it, and turns with it
        G[:, :, 2] *= -1.0
        G = G.reshape(2 * count, POSE)
        P = np.zeros((size + 2 * count, size + 2 * count))
        P[:size, :size] = self._P
        P[size:, :size] = G @ self._P[:POSE]
        P[:size, size:] = P[size:, :size].T
        own = G @ self._P[:POSE, :POSE] @ G.T
        P[size:, size:] = 0.5 * (own + own.T)
        block = size + np.arange(2 * count).reshape(count, 2)
        P[block[:, :, None], block[:, None, :]] += covariances
        self._P = P
        self._positions = np.concatenate([self._positions, positions])
        self._first = np.concatenate([self._first, positions])
        self._set_ids(np.concatenate([self._ids, ids]))

    def remove(self, ids: IntArray) -> None:
        """Let go of landmarks; those not held are passed over."""
        held = [self._slots[each] for each in ids.tolist() if each in self._slots]
        if not held:
            return
        kept = np.ones(len(self._ids), dtype=np.bool_)
        kept[held] = False
        columns = np.concatenate([np.arange(POSE), (POSE + 2 * np.flatnonzero(kept)[:, None] + np.arange(2)).ravel()])
        self._P = self._P[np.ix_(columns, columns)]
        self._positions, self._first = self._positions[kept], self._first[kept]
        self._set_ids(self._ids[kept])

    def difference(self, first: IntArray, second: IntArray) -> tuple[FloatArray, FloatArray]:
        """Positions (K, 2) m of landmarks from others, slots (K,) each, and the covariances (K, 2, 2) m^2 of that."""
        a, b = (POSE + 2 * slots[:, None] + np.arange(2) for slots in (first, second))
        P_ab = self._P[a[:, :, None], b[:, None, :]]
        P = self._P[a[:, :, None], a[:, None, :]] + self._P[b[:, :, None], b[:, None, :]]
        return self._positions[first] - self._positions[second], P - P_ab - P_ab.transpose(0, 2, 1)

    def variances(self) -> FloatArray:
        """Traces (L,) m^2 of the covariances of all landmarks' positions."""
        return np.asarray(np.diagonal(self._P)[POSE:].reshape(-1, 2).sum(axis=1))

    def merge(self, kept: int, dropped: int, variance: float) -> None:
        """Make one of two landmarks (ids): they are in one place, up to ``variance`` [m^2], and one is let go."""
        first, second = self.slots(np.array([kept])), self.slots(np.array([dropped]))
        offset, covariance = self.difference(first, second)
        a, b = (int(POSE + 2 * slots[0]) for slots in (first, second))
        PH = self._P[:, a : a + 2] - self._P[:, b : b + 2]
        S = covariance[0] + variance * np.eye(2)
        gain = np.linalg.solve(S, PH.T).T
        P = self._P - gain @ S @ gain.T
        self._P = 0.5 * (P + P.T)
        self._apply(-gain @ offset[0])
        self.remove(np.array([dropped]))

    def positions(self) -> FloatArray:
        """Positions (L, 2) m of all landmarks held, local frame."""
        return self._positions.copy()

    def _jacobians(self, slots: IntArray) -> FloatArray:
        """(K, 2, 3) of the offsets of landmarks by the robot's pose, at first estimates."""
        return _pose_jacobians(self._first[slots] - self._predicted)

    def _apply(self, change: FloatArray) -> None:
        x, y, heading = (self._pose + change[:POSE]).tolist()
        self._pose = np.array([x, y, _wrapped(heading)])
        self._positions = self._positions + change[POSE:].reshape(-1, 2)

    def _set_ids(self, ids: IntArray) -> None:
        self._ids = ids
        self._slots = {each: slot for slot, each in enumerate(ids.tolist())}


def upright_step(T_odom_before: FloatArray, T_odom_after: FloatArray) -> FloatArray:
    """``T_before_after`` (4, 4) between the upright frames at two poses of the body."""
    before, after = (transform_from_xyz_yaw(T[:3, 3], yaw_rad(T)) for T in (T_odom_before, T_odom_after))
    return np.asarray(invert(before) @ after)


def _pose_jacobians(offsets: FloatArray) -> FloatArray:
    """(K, 2, 3) of the offsets of landmarks (K, 2) from the robot, in local axes, by the robot's pose.

    By the position it is -I. A measured offset R z turns with the heading, so that a landmark that stays where it is
    seems to turn the other way: the innovation R z - (m - t) changes by -J (m - t) with the heading, J = [0 -1; 1 0].
    """
    G = np.zeros((len(offsets), 2, POSE))
    G[:, 0, 0] = G[:, 1, 1] = -1.0
    G[:, 0, 2], G[:, 1, 2] = offsets[:, 1], -offsets[:, 0]
    return G


def _by_pose(G: FloatArray, covariances: FloatArray) -> FloatArray:
    """(2 K, N): Jacobians (K, 2, 3) of offsets by the pose, which are -I in its position, times (3, N)."""
    return np.asarray((G[:, :, 2, None] * covariances[2] - covariances[:2]).reshape(-1, covariances.shape[1]))


def _squared_distances(offsets: FloatArray, covariances: FloatArray) -> FloatArray:
    """Squared Mahalanobis distances (K,) of offsets (K, 2), by the inverses of their covariances (K, 2, 2)."""
    x, y = offsets.T
    xx, xy, yy = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    return np.asarray((yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy))


def _wrapped(angle_rad: float) -> float:
    return float((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)
