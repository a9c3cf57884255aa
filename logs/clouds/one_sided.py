"""The centre of an object of which a sensor sees one side.

The centroid of what is seen lies on the near side. The outline that the sensor sees of a body that is symmetric about
its centre is symmetric, too: the middle between its left and its right edge is the centre, whatever the body's shape
and heading. A flat face that is seen at a right angle hides how deep the body behind it is: anything from nothing to as
deep as it is wide, or deeper, as of a car that is seen from behind. Its centre is taken to lie a quarter of the width
behind the face, give or take half the width. Of a thin pole far away the very edges are not seen, and only the nearest
of it is: without a correction for the spacing of the points it would seem the nearer the farther away it is, and the
way of the sensor the shorter.
"""

from typing import NamedTuple

import numpy as np

from logs.messages import FloatArray


class Centre(NamedTuple):
    """Centre (3,) m and covariance (3, 3) m^2 of an object."""

    position: FloatArray
    covariance: FloatArray


def seen_from_all_sides(points: FloatArray, voxel_m: float) -> Centre:
    """The mean of the voxels (M, 3) m of an object."""
    mean = points.mean(axis=0)
    centred = points - mean
    covariance = centred.T @ centred / len(points) ** 2 + voxel_m**2 / 12.0 * np.eye(3)
    return Centre(mean, covariance)


def seen_from_one_side(
    points: FloatArray, viewpoint: FloatArray, voxel_m: float, *, upright: bool, spacing_m: float = 0.0
) -> Centre:
    """The centre of an object by the voxels (M, 3) m of its near side.

    Args:
        points: of the object, m.
        viewpoint: (3,) m, of the sensor, in the same frame.
        voxel_m: side of the voxels.
        spacing_m: between neighbouring points, of which the voxels are means.
        upright: z points up. Then the outline is taken along the horizon; else along its shorter side.

    Returns:
        The centre. Its standard deviation is half the distance by which it was moved from the mean, besides that of a
        mean of so many voxels and of the depth behind a flat face; and, of the height, which the field of view or
        others may cut off at either end, what a cut of up to half the height amounts to.
    """
    mean, covariance = seen_from_all_sides(points, voxel_m)
    ray, across = _directions(points - mean, mean - viewpoint, upright=upright)
    along_m, across_m = (points - mean) @ ray, (points - mean) @ across
    left_m, right_m = across_m.min(), across_m.max()
    width_m = right_m - left_m
    # The edges of the outline: a tenth of the width at each side.
    left = along_m[across_m <= left_m + 0.1 * width_m]
    right = along_m[across_m >= right_m - 0.1 * width_m]
    outline_m = 0.5 * (np.median(left) + np.median(right))
    depth_m = np.subtract(*np.percentile(along_m, [95.0, 5.0]))
    flatness = max(0.0, 1.0 - 2.0 * depth_m / width_m) if width_m > 0.0 else 0.0
    beyond_m = _beyond_the_edge_m(width_m, max(spacing_m, voxel_m))
    # Nothing that is seen lies behind the centre plane of a convex body on average: the centre is never nearer.
    behind_m = max(outline_m + 0.25 * flatness * width_m, 0.0) + beyond_m
    aside_m = 0.5 * (left_m + right_m)
    upwards = np.cross(ray, across)
    height_m = np.ptp(points @ upwards)
    variances = [
        (ray, (0.5 * behind_m) ** 2 + (0.5 * flatness * width_m) ** 2 + (0.5 * beyond_m) ** 2),
        (across, (0.5 * aside_m) ** 2),
        (upwards, height_m**2 / 48.0),
    ]
    covariance = covariance + sum(variance * np.outer(axis, axis) for axis, variance in variances)
    return Centre(mean + behind_m * ray + aside_m * across, covariance)


def _beyond_the_edge_m(width_m: float, spacing_m: float) -> float:
    """How much deeper the edges of a body lie than the outermost points, which are half a spacing from them.

    A round body is half as deep as it is wide. Where that is less than the spacing, its shape is not seen, and it is
    taken for round, as poles and trunks are; the wider it is, the better the shape is seen.
    """
    half_m = 0.5 * (width_m + spacing_m)
    round_m = float(np.sqrt(half_m**2 - (0.5 * width_m) ** 2))
    return round_m * min(2.0 * spacing_m / max(width_m, spacing_m), 1.0)


def _directions(centred: FloatArray, view: FloatArray, *, upright: bool) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (3,) away from the sensor and along the width of the outline."""
    ray = view * [1.0, 1.0, 0.0] if upright else view
    length = np.linalg.norm(ray)
    if length == 0.0:
        return np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    ray = ray / length
    if upright:
        return ray, np.array([-ray[1], ray[0], 0.0])
    flat = centred - np.outer(centred @ ray, ray)
    _, _, axes = np.linalg.svd(np.vstack([flat, 1e-9 * np.eye(3)]), full_matrices=False)
    across = axes[1] - (axes[1] @ ray) * ray
    return ray, across / np.linalg.norm(across)
