"""The rigid motion that lays estimated points on true ones, by least squares, and the axes of the true body."""

import numpy as np
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import apply, fit_yaw_translation, make_transform

ONE_POINT_M = 1e-6
"""Points that are spread less are one point."""


def align_yaw_translation(points_est: FloatArray, points_gt: FloatArray) -> FloatArray:
    """``T_world_map`` (4, 4) by yaw about the common vertical and a 3-D translation, least squares in the plane.

    Both frames must have z up.

    Args:
        points_est: (N, 3) float64, metres, map frame.
        points_gt: (N, 3) float64, metres, world frame.

    Raises:
        EvaluationError: the points of either set are one point, or lie above one another, so that yaw is arbitrary.
    """
    for name, points in (("estimated", points_est), ("true", points_gt)):
        spread = _principal_spreads(points[:, :2])[0]
        if spread < ONE_POINT_M:
            raise EvaluationError(
                f"the {len(points)} {name} points are within {spread:.3g} m of one another in the plane, "
                "so no heading can be found; evaluate a drive that moves"
            )
    return fit_yaw_translation(points_est, points_gt)


def align_path(points_est: FloatArray, points_gt: FloatArray) -> FloatArray:
    """``T_world_map`` (4, 4), rotation and translation, no scale; on a straight line, where that is ambiguous, yaw and
    translation.

    Args:
        points_est: (N, 3) float64, metres, map frame.
        points_gt: (N, 3) float64, metres, world frame.

    Raises:
        EvaluationError: the points do not move in the plane.
    """
    spreads = [_principal_spreads(points) for points in (points_est, points_gt)]
    # Points on a straight line leave the roll about it open.
    if any(second < 1e-3 * first or first < ONE_POINT_M for first, second, _ in spreads):
        return align_yaw_translation(points_est, points_gt)
    mean_est, mean_gt = points_est.mean(axis=0), points_gt.mean(axis=0)
    R = Rotation.align_vectors(points_gt - mean_gt, points_est - mean_est)[0].as_matrix()
    return make_transform(R, mean_gt - R @ mean_est)


def aligned_errors_m(T_world_map: FloatArray, points_est: FloatArray, points_gt: FloatArray) -> FloatArray:
    """Distances (N,) m of estimated points (N, 3) m, brought into the world, from the true ones."""
    return np.linalg.norm(apply(T_world_map, points_est) - points_gt, axis=1)


def find_axes(R_est: FloatArray, R_gt: FloatArray) -> FloatArray:
    """The rotation (3, 3), by quarter turns about axes, from the axes of the estimated body to those of the true one.

    Programs name the axes of a body differently. Of orientations (N, 3, 3) in one world those of the nearest quarter
    turn differ by less than 45 deg on average; where they do not, as where the truth has none, the axes are the same.
    """
    turns = np.rint(Rotation.create_group("O").as_matrix())
    traces = np.einsum("nji,njk,tik->t", R_est, R_gt, turns) / len(R_est)
    best = int(np.argmax(traces))
    return turns[best] if traces[best] > 1.0 + np.sqrt(2.0) else np.eye(3)


def find_point(T_world_body: FloatArray, points: FloatArray) -> FloatArray:
    """Offset (3,) m, in the plane of a body at (N, 4, 4), of the point of it that has the true positions (N, 3) m.

    By least squares together with the heading and the position of the world, which are nearly right.
    """
    xy, design = T_world_body[:, :2, 3], np.zeros((len(points), 2, 5))
    centred = xy - xy.mean(axis=0)
    design[:, 0, 0], design[:, 1, 0] = -centred[:, 1], centred[:, 0]
    design[:, :, 1:3] = np.eye(2)
    design[:, :, 3:] = T_world_body[:, :2, :2]
    found = np.linalg.lstsq(design.reshape(-1, 5), (points[:, :2] - xy).ravel(), rcond=None)[0]
    return np.array([*found[3:], 0.0])


def _principal_spreads(points: FloatArray) -> FloatArray:
    """RMS spread (D,), metres, largest first, of the points (N, D) along their principal axes."""
    centred = points - points.mean(axis=0)
    variances = np.linalg.eigvalsh(centred.T @ centred / len(points))[::-1]
    return np.sqrt(np.maximum(variances, 0.0))
