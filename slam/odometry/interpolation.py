"""The trajectory between keyframes: the odometry, interpolated to meet the optimised keyframes."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import blend, invert


def interpolate_between_keyframes(
    stamps_ns: IntArray,
    T_odom_body: FloatArray,
    keyframe_indices: IntArray,
    T_map_keyframe: FloatArray,
    segments: IntArray,
) -> FloatArray:
    """Poses ``T_map_body`` (N, 4, 4) of all odometry poses.

    Each pose is predicted from the keyframe before it and from the one after it, and is blended between the two by
    time, so that it meets both keyframes and has no step at either. If only one of them is of the segment of the pose,
    it alone decides.

    Args:
        stamps_ns: (N,) strictly increasing.
        T_odom_body: (N, 4, 4) m.
        keyframe_indices: (K,) which of the N poses are keyframes, ascending; the first is 0.
        T_map_keyframe: (K, 4, 4) m, optimised.
        segments: (N,) number of breaks in the odometry before each pose.
    """
    before = np.searchsorted(keyframe_indices, np.arange(len(stamps_ns)), side="right") - 1
    after = np.minimum(before + 1, len(keyframe_indices) - 1)
    after = np.where(segments[keyframe_indices[after]] == segments, after, before)
    before = np.where(segments[keyframe_indices[before]] == segments, before, after)

    def predict(keyframe: IntArray) -> FloatArray:
        return T_map_keyframe[keyframe] @ invert(T_odom_body[keyframe_indices[keyframe]]) @ T_odom_body

    T_before, T_after = predict(before), predict(after)
    start, end = stamps_ns[keyframe_indices[before]], stamps_ns[keyframe_indices[after]]
    fraction = np.where(end > start, (stamps_ns - start) / np.maximum(end - start, 1), 0.0)
    return blend(T_before, T_after, fraction)
