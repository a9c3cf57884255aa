"""A segment of the drive moved as a whole to where an edge puts it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from slam.backend.factors import Edge, EdgeKind, Factor
from slam.common.arrays import FloatArray
from slam.common.geometry import invert


def shift_of_segment(edge: Edge, T_from: FloatArray, T_to: FloatArray, moved: Collection[int]) -> FloatArray:
    """The transform (4, 4), map frame, that moves the keyframes ``moved``, at one end of an edge, to where the edge
    places them.

    ``T_from``, ``T_to``: (4, 4), ``T_map_body`` of the ends of the edge as they are now.
    """
    if edge.to_keyframe in moved:
        return np.asarray(T_from @ edge.T_from_to @ invert(T_to))
    return np.asarray(T_to @ invert(edge.T_from_to) @ invert(T_from))


def moved_estimate(
    estimate: gtsam.Values,
    keyframes: Iterable[int],
    landmarks: Iterable[int],
    moved_keyframes: Collection[int],
    moved_landmarks: Collection[int],
    T_shift: FloatArray,
) -> gtsam.Values:
    """The estimate of ``keyframes`` and ``landmarks``, with some of them moved by ``T_shift`` (4, 4)."""
    values, shift = gtsam.Values(), gtsam.Pose3(T_shift)
    for keyframe in keyframes:
        pose = estimate.atPose3(X(keyframe))
        values.insert(X(keyframe), shift.compose(pose) if keyframe in moved_keyframes else pose)
    for landmark in landmarks:
        point = estimate.atPoint3(L(landmark))
        values.insert(L(landmark), shift.transformFrom(point) if landmark in moved_landmarks else point)
    return values


def relaxed_breaks(factors: Mapping[int, Factor], keyframes: Collection[int], values: gtsam.Values) -> dict[int, Edge]:
    """Breaks of the odometry between some keyframes and the others, by number, as the estimate ``values`` has them.

    They hold no information, and would pull at a segment that was moved far.
    """
    relaxed = dict[int, Edge]()
    for number, factor in factors.items():
        if not isinstance(factor, Edge) or factor.kind != EdgeKind.DISCONTINUITY:
            continue
        if (factor.from_keyframe in keyframes) != (factor.to_keyframe in keyframes):
            T_from, T_to = (
                values.atPose3(X(keyframe)).matrix() for keyframe in (factor.from_keyframe, factor.to_keyframe)
            )
            relaxed[number] = replace(factor, T_from_to=np.asarray(invert(T_from) @ T_to))
    return relaxed
