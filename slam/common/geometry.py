"""Rigid transforms as ``(..., 4, 4)`` float64 arrays, metres; every function takes one or a batch.

``T_a_b`` maps points of frame b into frame a: ``p_a = T_a_b @ p_b``. In a chain of transforms the inner names are
equal.
"""

import math
import warnings

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from slam.common.arrays import FloatArray, IntArray


def make_transform(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Stack ``rotation`` (..., 3, 3) and ``translation`` (..., 3) into transforms (..., 4, 4)."""
    T = np.zeros((*(translation.shape[:-1] or rotation.shape[:-2]), 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1.0
    return T


def transform_from_xyz_yaw(xyz: FloatArray, yaw_rad: FloatArray | float) -> FloatArray:
    """Transforms (..., 4, 4) that turn about z by ``yaw_rad`` (...) and move by ``xyz`` (..., 3)."""
    yaw, translation = np.asarray(yaw_rad, dtype=np.float64), np.asarray(xyz, dtype=np.float64)
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.zeros((*yaw.shape, 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = c
    R[..., 0, 1], R[..., 1, 0] = -s, s
    R[..., 2, 2] = 1.0
    return make_transform(R, translation)


def invert(T_a_b: FloatArray) -> FloatArray:
    """``T_b_a`` of ``T_a_b`` (..., 4, 4), by transposing the rotation."""
    R_b_a, T_b_a = T_a_b[..., :3, :3].swapaxes(-1, -2), T_a_b.copy()
    T_b_a[..., :3, :3] = R_b_a
    T_b_a[..., :3, 3] = -np.einsum("...ij,...j->...i", R_b_a, T_a_b[..., :3, 3])
    return T_b_a


def apply(T_a_b: FloatArray, points_b: FloatArray) -> FloatArray:
    """Points (N, 3) of frame b, in frames a: (..., N, 3); N = 0 gives (..., 0, 3)."""
    return points_b @ T_a_b[..., :3, :3].swapaxes(-1, -2) + T_a_b[..., None, :3, 3]


def apply_each(T_a_b: FloatArray, points_b: FloatArray) -> FloatArray:
    """Points (N, 3) m of frame b in frame a, each by its own transform (N, 4, 4)."""
    return np.einsum("nij,nj->ni", T_a_b[:, :3, :3], points_b) + T_a_b[:, :3, 3]


def skew(vectors: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) that turn a vector b into the cross product of ``vectors`` (..., 3) and b."""
    matrices = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[..., j, k], matrices[..., k, j] = -vectors[..., i], vectors[..., i]
    return matrices


def view_change(before: FloatArray, after: FloatArray) -> FloatArray:
    """By how much (N,) [rad] the view of objects differs from two places, at offsets (N, 3) in axes that do not turn:
    by the direction that they are seen from and by the logarithm of the distance.
    """
    (x, y, z), (u, v, w) = before.T, after.T
    sine = np.sqrt((y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2)  # np.cross is slow
    angle = np.arctan2(sine, np.einsum("ni,ni->n", before, after))
    squares = (np.maximum(np.einsum("ni,ni->n", each, each), 1e-300) for each in (before, after))
    return np.hypot(angle, 0.5 * np.subtract(*(np.log(each) for each in squares)))


def left_jacobian(vector: FloatArray) -> FloatArray:
    """Left Jacobian (3, 3) of the rotation by a vector (3,) rad (Barfoot, State Estimation for Robotics, eq. 7.37)."""
    angle = math.sqrt(vector @ vector)
    K = skew(vector)
    if angle < 1e-6:
        return np.eye(3) + 0.5 * K
    first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    return np.eye(3) + first * K + second * K @ K


def adjoint(T_a_b: FloatArray) -> FloatArray:
    """Matrix (6, 6) that turns a small motion (rotation, translation) along the axes of frame b into one of frame a."""
    R = T_a_b[:3, :3]
    return np.block([[R, np.zeros((3, 3))], [skew(T_a_b[:3, 3]) @ R, R]])


def covariance_in_axes(covariance_a: FloatArray, R_a_b: FloatArray) -> FloatArray:
    """Covariance (6, 6) of a rotation and a translation, each in the axes of frame a, in those of frame b."""
    R = np.zeros((6, 6))
    R[:3, :3] = R[3:, 3:] = R_a_b
    return R.T @ covariance_a @ R


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """The directions (N, D) of vectors (N, D); zero vectors stay as they are."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)[:, None]


def squared_mahalanobis(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Squared Mahalanobis distances (N,) of errors (N, D) with their covariances (N, D, D)."""
    return np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def pose_errors(T_est: FloatArray, T_true: FloatArray) -> FloatArray:
    """Errors (N, 6) of poses (N, 4, 4), rotation [rad] first: ``T_true = T_est Exp(error)``, in the body axes.

    It is what the covariances of poses and closures are about.
    """
    return RigidTransform.from_matrix(relative(T_est, T_true)).as_exp_coords()


def rotation_angle_rad(T: FloatArray) -> FloatArray:
    """Angle of rotation (...) in [0, pi] of transforms (..., 4, 4).

    From the sine and the cosine together, so that it is exact near 0 and near pi, where arccos alone is not.
    """
    doubled_sine = np.hypot(
        np.hypot(T[..., 2, 1] - T[..., 1, 2], T[..., 0, 2] - T[..., 2, 0]), T[..., 1, 0] - T[..., 0, 1]
    )
    return np.arctan2(doubled_sine, T[..., 0, 0] + T[..., 1, 1] + T[..., 2, 2] - 1.0)


def rotation_of(vector: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of rotation vectors (..., 3) rad."""
    return Rotation.from_rotvec(vector).as_matrix()


def yaw_rad(T: FloatArray) -> FloatArray:
    """Heading (...) of the x axis about z, in (-pi, pi], of transforms (..., 4, 4)."""
    return np.arctan2(T[..., 1, 0], T[..., 0, 0])


def gravity_frame(T: FloatArray) -> FloatArray:
    """``T`` (..., 4, 4), of a body whose frame has z up, upright: at the body, heading as it does."""
    return transform_from_xyz_yaw(T[..., :3, 3], yaw_rad(T))


def fit_yaw_translation(points_a: FloatArray, points_b: FloatArray) -> FloatArray:
    """``T_b_a`` (4, 4), a yaw about the common vertical and a 3-D translation, that brings points (N, 3) of a nearest
    to those of b, by least squares in the plane. Where they are one point, or lie above one another, the yaw is 0.
    """
    mean_a, mean_b = points_a.mean(axis=0), points_b.mean(axis=0)
    a, b = (points_a - mean_a)[:, :2] @ (1.0, 1.0j), (points_b - mean_b)[:, :2] @ (1.0, 1.0j)
    T_b_a = transform_from_xyz_yaw(np.zeros(3), np.angle(np.vdot(a, b)))
    T_b_a[:3, 3] = mean_b - T_b_a[:3, :3] @ mean_a
    return T_b_a


def polar_cells(points: FloatArray, range_m: float, rings: int, sectors: int) -> tuple[IntArray, IntArray]:
    """Ring and sector (N,) of points (N, 2 or more) m in the plane: ``rings`` of equal width reach up to ``range_m``,
    points beyond it have higher numbers.
    """
    x, y = points[:, 0], points[:, 1]
    ring = (np.hypot(x, y) / range_m * rings).astype(np.int64)
    sector = ((np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * sectors).astype(np.int64)
    return ring, sector % sectors


def roll_pitch_yaw_deg(R: FloatArray) -> FloatArray:
    """Angles (3,) about the fixed axes x, y, z, in this order."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # one of the angles may be chosen then, and is 0
        return Rotation.from_matrix(R).as_euler("xyz", degrees=True) + 0.0


def rigid(T: FloatArray) -> FloatArray:
    """``T`` (4, 4) without the rounding that products gather."""
    return make_transform(Rotation.from_matrix(T[:3, :3]).as_matrix(), T[:3, 3])


def step_lengths(positions: FloatArray) -> FloatArray:
    """Distance (N - 1,) from each of the positions (N, D) to the next."""
    return np.linalg.norm(np.diff(positions, axis=0), axis=1)


def travelled_m(positions: FloatArray) -> FloatArray:
    """Path length (N,) from the first position to each of (N, D)."""
    return np.concatenate([[0.0], np.cumsum(step_lengths(positions))])[: len(positions)]


def interpolate(stamps_ns: IntArray, T_a_b: FloatArray, at_ns: IntArray) -> FloatArray:
    """Poses (M, 4, 4) at ``at_ns`` (M,), between the poses (N, 4, 4), one at least, at the strictly increasing
    ``stamps_ns`` (N,): linear in translation, shortest arc in rotation, held before the first and after the last.
    """
    if len(stamps_ns) == 1:
        return np.repeat(T_a_b, len(at_ns), axis=0)
    # Offsets from the stamp before are exact in float64; absolute epoch nanoseconds are not.
    upper = np.clip(np.searchsorted(stamps_ns, at_ns, side="right"), 1, len(stamps_ns) - 1)
    lower = upper - 1
    fraction = (at_ns - stamps_ns[lower]) / (stamps_ns[upper] - stamps_ns[lower])
    return blend(T_a_b[lower], T_a_b[upper], np.clip(fraction, 0.0, 1.0))


def blend(T_start: FloatArray, T_end: FloatArray, fraction: FloatArray | float) -> FloatArray:
    """Poses (..., 4, 4) a ``fraction`` (...) of the way from one to another: linear in translation, shortest arc in
    rotation.
    """
    share = np.asarray(fraction)[..., None]
    start, end = T_start[..., :3, :3], T_end[..., :3, :3]
    turn = Rotation.from_matrix(np.swapaxes(start, -1, -2) @ end, assume_valid=True).as_rotvec()
    translation = (1.0 - share) * T_start[..., :3, 3] + share * T_end[..., :3, 3]
    return make_transform(start @ rotation_of(share * turn), translation)


def relative(T_odom_from: FloatArray, T_odom_to: FloatArray) -> FloatArray:
    """``T_from_to`` (4, 4) of two poses of one track."""
    return invert(T_odom_from) @ T_odom_to
