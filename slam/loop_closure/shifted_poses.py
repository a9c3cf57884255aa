"""Poses shifted along the heading: in a street with rows of objects many of them fit nearly as well."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.geometry import apply
from slam.object_map.submap import Submap

SHIFTS_RANGES = np.concatenate([np.arange(-40.0, -3.0), np.arange(4.0, 41.0)]) / 30.0
"""Shifts, in sensor ranges."""
MATCH_RANGES = 1.5 / 30.0
"""Objects match after a shift within that radius, in sensor ranges."""
TRIED = 4
"""Shifts with most matches that are returned."""


def shifted_along_track(
    query: Submap, reference: Submap, T_reference_query: FloatArray, sensor_range_m: float
) -> FloatArray:
    """A pose (4, 4) shifted along its heading to where most objects of the query match: poses (S, 4, 4)."""
    placed = apply(T_reference_query, query.positions)
    offsets = reference.positions[:, None, :2] - placed[None, :, :2]  # (M, N, 2)
    same = reference.labels[:, None] == query.labels
    shifts_m = SHIFTS_RANGES * sensor_range_m
    radius_m = MATCH_RANGES * sensor_range_m
    shifted_offsets = offsets[None] - shifts_m[:, None, None, None] * T_reference_query[:2, 0]  # (S, M, N, 2)
    near = same & (np.einsum("smni,smni->smn", shifted_offsets, shifted_offsets) < radius_m**2)
    match_counts = near.any(axis=1).sum(axis=1)
    likeliest_m = shifts_m[np.argsort(-match_counts, kind="stable")][:TRIED]
    T_shifted = np.tile(T_reference_query, (len(likeliest_m), 1, 1))
    T_shifted[:, :2, 3] += likeliest_m[:, None] * T_reference_query[:2, 0]
    return T_shifted
