"""The choice of the anchor of each attached keyframe.

As in reduced pose graphs (Johannsson et al., ICRA 2013), a place that was passed often gets no new variables; here the
observations from there go to the keyframe of the second traversal, and landmarks stay variables. The first traversal
stays as it is: its keyframes hold the shape of the map, and a keyframe attached to one counts as known relative to it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import sparse

from slam.common.arrays import BoolArray, FloatArray, IntArray

COMMON_SHARE = 0.5
"""Two keyframes are of one place if one observed at least that share of the landmarks of the other."""


def find_anchors(
    observations: Iterable[tuple[int, int]],
    keyframes: IntArray,
    travel_m: FloatArray,
    *,
    is_settled: BoolArray,
    may_anchor: BoolArray,
    min_travel_m: float,
) -> dict[int, int]:
    """The keyframes that can be attached to one of an earlier traversal, with that anchor.

    A keyframe returns to a place where an earlier one has enough of its landmarks: three determine the relative pose,
    and ``COMMON_SHARE`` of its own. It is attached to the one that has most of those that had returned
    themselves; if there is none, it may be an anchor. Settled keyframes that observed nothing are attached like the
    next one that did.

    Args:
        observations: keyframe and landmark of each, by the variables of landmarks.
        keyframes: (K,) ids, in the order of the drive.
        travel_m: (K,), of each.
        is_settled: (K,), which of them may be attached.
        may_anchor: (K,), which may be anchors.
        min_travel_m: keyframes with less travel between them are of one traversal.
    """
    seen = _incidence(observations, keyframes)
    totals = np.diff(seen.indptr)
    common = (seen @ seen.T).tocsr()
    anchors = dict[int, int]()
    is_variable = np.zeros(len(keyframes), dtype=np.bool_)
    is_anchor = np.zeros(len(keyframes), dtype=np.bool_)
    waiting = list[int]()
    for row, keyframe in enumerate(keyframes.tolist()):
        if not totals[row]:
            waiting = [*waiting, keyframe] if is_settled[row] else []
            continue
        of_row = slice(common.indptr[row], common.indptr[row + 1])
        others, counts = common.indices[of_row], common.data[of_row]
        of_place = is_variable[others] & (travel_m[others] < travel_m[row] - min_travel_m)
        of_place &= counts >= max(3, COMMON_SHARE * totals[row])
        usable = of_place & is_anchor[others]
        if not is_settled[row] or not usable.any():
            is_variable[row] = True
            is_anchor[row] = may_anchor[row] and of_place.any()
        else:
            best = others[usable][np.lexsort((others[usable], -counts[usable]))[0]]
            anchors |= dict.fromkeys((*waiting, keyframe), int(keyframes[best]))
        waiting = []
    return anchors


def _incidence(observations: Iterable[tuple[int, int]], keyframes: IntArray) -> sparse.csr_array:
    """Which keyframe observed which landmark, as ones in an array (K, L)."""
    pairs = np.unique(np.array(list(observations), dtype=np.int64).reshape(-1, 2), axis=0)
    rows_of = {keyframe: row for row, keyframe in enumerate(keyframes.tolist())}
    rows = np.array([rows_of[keyframe] for keyframe in pairs[:, 0].tolist()], dtype=np.int64)
    landmarks, columns = np.unique(pairs[:, 1], return_inverse=True)
    ones = np.ones(len(pairs), dtype=np.int64)
    return sparse.csr_array((ones, (rows, columns)), shape=(len(keyframes), len(landmarks)))
