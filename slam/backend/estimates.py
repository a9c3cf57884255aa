"""All positions of a set of values at once, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from slam.common.arrays import FloatArray, IntArray

_INDEX_BITS = np.uint64(2**56 - 1)  # of a symbol; the letter stands before them


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Ids of keyframes (K,) and of landmarks (L,), and their positions (K, 3) and (L, 3) m in the map."""

    keyframes: IntArray
    keyframe_positions: FloatArray
    landmarks: IntArray
    landmark_positions: FloatArray


def read_estimates(values: gtsam.Values, attached: IntArray, attached_positions: FloatArray) -> Estimates:
    """The positions of all keyframes and landmarks in ``values``, and of attached keyframes (N,), (N, 3) m."""
    # Both the keys and what is extracted are in the order of the symbols, in which l (landmarks) comes before x.
    indices = (np.array(values.keys(), dtype=np.uint64) & _INDEX_BITS).astype(np.int64)
    landmark_positions = gtsam.utilities.extractPoint3(values).reshape(-1, 3)
    keyframe_positions = gtsam.utilities.extractPose3(values).reshape(-1, 12)[:, 9:]
    count = len(landmark_positions)
    return Estimates(
        np.concatenate([indices[count:], attached]),
        np.concatenate([keyframe_positions, attached_positions]),
        indices[:count],
        landmark_positions,
    )
