"""Registration of two constellations of objects from an approximate pose.

The input is positions, their noise and labels; neither map nor graph.
"""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, yaw_rad
from slam.registration.estimate import Registration, estimate, not_found
from slam.registration.parameters import RegistrationConfig
from slam.registration.refinement import LevelPose, Pairs, refine_pose


def refine(
    query_positions: FloatArray,
    query_labels: IntArray,
    reference_positions: FloatArray,
    reference_labels: IntArray,
    T_initial: FloatArray,
    config: RegistrationConfig,
    *,
    query_sigmas: FloatArray,
    reference_sigmas: FloatArray,
) -> Registration:
    """The pose near an approximate one at which objects of equal label meet, and which do.

    Each object pairs with the nearest one of its label, if that is mutual and inside a gate, which shrinks from
    ``config.search_radius_m`` to the noise; weighted least squares; and again, until nothing changes.

    Args:
        query_positions: (N, 3) m, z up.
        query_labels: (N,) int64.
        reference_positions: (M, 3) m, z up.
        reference_labels: (M,) int64.
        T_initial: (4, 4) of the query in the reference; of its rotation only the yaw is used.
        config: gates and limits.
        query_sigmas: (N,) m, noise of a position along any axis.
        reference_sigmas: (M,) m.
    """
    if not len(query_positions) or not len(reference_positions):
        return not_found("no object of the query is near one of its label in the reference")
    query_middle, reference_middle = query_positions.mean(axis=0), reference_positions.mean(axis=0)
    query, reference = query_positions - query_middle, reference_positions - reference_middle
    place = apply(T_initial, query_middle[None])[0] - reference_middle
    turn = np.exp(1j * float(yaw_rad(T_initial)))
    plane, reference_plane = (points[:, 0] + 1j * points[:, 1] for points in (query, reference))
    pose = LevelPose(complex(turn), complex(*place[:2]), float(place[2]))
    sigma_m = float(np.hypot(query_sigmas.max(), reference_sigmas.max()))
    # Objects farther apart are not matched while the pose is refined.
    reach_m = 2.0 * max(config.search_radius_m, config.gate_sigma * sigma_m)
    apart_m = np.abs((turn * plane + pose.shift)[:, None] - reference_plane)
    rows = np.argwhere((apart_m <= reach_m) & (query_labels[:, None] == reference_labels))
    if not len(rows):
        return not_found("no object of the query is near one of its label in the reference")
    q, r = rows.T
    variances = query_sigmas[q] ** 2 + reference_sigmas[r] ** 2
    # A tilt that neither frame knows of shows as a height that grows with the distance.
    variances_z = variances + config.height_sigma_m**2 + (config.tilt_sigma_rad * np.abs(plane[q])) ** 2
    pairs = Pairs(
        rows,
        plane[q],
        reference_plane[r],
        query[q, 2],
        reference[r, 2],
        np.sqrt(variances),
        np.sqrt(variances_z),
        query_middle,
        reference_middle,
    )
    return estimate(refine_pose(pose, pairs, config), pairs, config)
