"""Keyframes that are not variables of the graph: each moves rigidly with another one, its anchor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from slam.backend.factors import PRIOR_SIGMA_RAD, Edge, EdgeKind, Observation
from slam.common.arrays import FloatArray
from slam.common.geometry import adjoint, invert


class AttachedKeyframes:
    """Anchors of keyframes and ``T_anchor_keyframe``; rewrites factors of attached keyframes as factors of anchors."""

    def __init__(self) -> None:
        self.anchors: dict[int, int] = {}
        """The anchor of each attached keyframe."""
        self._transforms: dict[int, FloatArray] = {}
        self.covariances: dict[int, FloatArray] = {}
        """Of the pose (6, 6) of each attached keyframe, as it was when it was attached."""

    def attach(
        self, anchors: Mapping[int, int], covariances: Mapping[int, FloatArray], pose: Callable[[int], FloatArray]
    ) -> None:
        """Attach keyframes to their anchors, which stay variables, as their poses (4, 4) in the map are now, with
        ``covariances`` (6, 6).
        """
        self.covariances |= covariances
        self._transforms |= {each: invert(pose(anchor)) @ pose(each) for each, anchor in anchors.items()}
        self.anchors |= anchors

    def pose(self, keyframe: int, T_map_anchor: FloatArray) -> FloatArray:
        """``T_map_body`` (4, 4) of an attached keyframe."""
        return T_map_anchor @ self._transforms[keyframe]

    def edge(self, edge: Edge) -> Edge:
        """The same constraint between anchors; covariances are about the axes of the keyframe that it leads to."""
        T_from_to, covariance = edge.T_from_to, edge.covariance
        start, end = edge.from_keyframe, edge.to_keyframe
        if start in self.anchors:
            T_from_to = self._transforms[start] @ T_from_to
        if end in self.anchors:
            Ad = adjoint(self._transforms[end])
            covariance = Ad @ covariance @ Ad.T
            T_from_to = T_from_to @ invert(self._transforms[end])
        return Edge(self.anchors.get(start, start), self.anchors.get(end, end), T_from_to, covariance, edge.kind)

    def observation(self, observation: Observation) -> Observation:
        """The same observation from the anchor."""
        if observation.keyframe not in self.anchors:
            return observation
        T = self._transforms[observation.keyframe]
        return replace(
            observation,
            keyframe=self.anchors[observation.keyframe],
            position=T[:3, :3] @ observation.position + T[:3, 3],
            covariance=T[:3, :3] @ observation.covariance @ T[:3, :3].T,
        )

    def rigid_edges(self, sigma_m: float) -> list[Edge]:
        """An edge from the anchor of each to it, as stiff as the prior of the first keyframe."""
        covariance = np.diag(np.repeat([PRIOR_SIGMA_RAD, sigma_m], 3) ** 2)
        return [
            Edge(anchor, keyframe, self._transforms[keyframe], covariance, EdgeKind.CONDENSED)
            for keyframe, anchor in self.anchors.items()
        ]
