"""Keyframes that are not variables of the graph: each moves rigidly with another one, its anchor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from slam.backend.factors import PRIOR_SIGMA_RAD, Edge, EdgeKind, Observation
from slam.common.arrays import FloatArray
from slam.common.geometry import adjoint, invert, skew


class AttachedKeyframes:
    """Anchors of keyframes and ``T_anchor_keyframe``; rewrites factors of attached keyframes as factors of anchors.

    How well the transform is known is added to the noise of edges. Covariances are about the axes of the keyframe.
    """

    def __init__(self) -> None:
        self._anchors: dict[int, int] = {}
        self._transforms: dict[int, FloatArray] = {}
        self._covariances: dict[int, FloatArray] = {}

    @property
    def anchors(self) -> Mapping[int, int]:
        """The anchor of each attached keyframe."""
        return self._anchors

    def attach(
        self, anchors: Mapping[int, int], covariances: Mapping[int, FloatArray], pose: Callable[[int], FloatArray]
    ) -> None:
        """Attach keyframes to their anchors, as their poses (4, 4) in the map are now, known to ``covariances`` (6, 6).

        Keyframes that are attached to one of them are attached to its anchor.
        """
        joined = {keyframe: anchors[anchor] for keyframe, anchor in self._anchors.items() if anchor in anchors}
        for keyframe in joined:
            Ad = adjoint(invert(self._transforms[keyframe]))
            self._covariances[keyframe] = self._covariances[keyframe] + Ad @ covariances[self._anchors[keyframe]] @ Ad.T
        self._covariances |= covariances
        joined |= anchors
        self._transforms |= {each: invert(pose(anchor)) @ pose(each) for each, anchor in joined.items()}
        self._anchors |= joined

    def pose(self, keyframe: int, T_map_anchor: FloatArray) -> FloatArray:
        """``T_map_body`` (4, 4) of an attached keyframe."""
        return np.asarray(T_map_anchor @ self._transforms[keyframe])

    def moves(self, edge: Edge) -> bool:
        """Whether an end of an edge is attached."""
        return edge.from_keyframe in self._anchors or edge.to_keyframe in self._anchors

    def edge(self, edge: Edge) -> Edge:
        """The same constraint between anchors; covariances are about the axes of the keyframe that it leads to."""
        T_from_to, covariance = edge.T_from_to, edge.covariance
        start, end = edge.from_keyframe, edge.to_keyframe
        if start in self._anchors:
            Ad = adjoint(invert(T_from_to))
            covariance = covariance + Ad @ self._covariances[start] @ Ad.T
            T_from_to = self._transforms[start] @ T_from_to
        if end in self._anchors:
            Ad = adjoint(self._transforms[end])
            covariance = Ad @ (covariance + self._covariances[end]) @ Ad.T
            T_from_to = T_from_to @ invert(self._transforms[end])
        return Edge(self._anchors.get(start, start), self._anchors.get(end, end), T_from_to, covariance, edge.kind)

    def observation(self, observation: Observation) -> Observation:
        """The same observation from the anchor."""
        if observation.keyframe not in self._anchors:
            return observation
        T = self._transforms[observation.keyframe]
        return replace(
            observation,
            keyframe=self._anchors[observation.keyframe],
            position=T[:3, :3] @ observation.position + T[:3, 3],
            covariance=T[:3, :3] @ observation.covariance @ T[:3, :3].T,
        )

    def rigid_edges(self, sigma_m: float) -> list[Edge]:
        """An edge from the anchor of each to it, as stiff as the prior of the first keyframe."""
        covariance = np.diag(np.repeat([PRIOR_SIGMA_RAD, sigma_m], 3) ** 2)
        return [
            Edge(anchor, keyframe, self._transforms[keyframe], covariance, EdgeKind.CONDENSED)
            for keyframe, anchor in self._anchors.items()
        ]

    def poses(self, keyframes: Sequence[int], pose: Callable[[int], FloatArray]) -> FloatArray:
        """``T_map_body`` (K, 4, 4) of keyframes, attached or not; ``pose`` is that of a variable."""
        T = [
            self.pose(keyframe, pose(self._anchors[keyframe])) if keyframe in self._anchors else pose(keyframe)
            for keyframe in keyframes
        ]
        return np.array(T).reshape(-1, 4, 4)

    def covariances(self, keyframes: Sequence[int], of_anchors: FloatArray) -> FloatArray:
        """Covariances (K, 6, 6) of keyframes, given those of their anchors, or their own where they are variables."""
        covariances = of_anchors.copy()
        for row, keyframe in enumerate(keyframes):
            if keyframe in self._anchors:
                Ad = adjoint(invert(self._transforms[keyframe]))
                covariances[row] = Ad @ of_anchors[row] @ Ad.T + self._covariances[keyframe]
        return covariances


def relative_covariances(
    observations: Iterable[Observation], anchors: Mapping[int, int], *, sensor_range_m: float
) -> dict[int, FloatArray]:
    """Covariance (6, 6) of the pose of each keyframe relative to its anchor, about the axes of the keyframe.

    Args:
        observations: of variables, from the keyframes and from their anchors: those that both observed tell the pose.
        anchors: of the keyframes in question.
        sensor_range_m: what they do not tell is off by half a turn and by that at most.
    """
    seen = dict[int, dict[int, Observation]]()
    for each in observations:
        seen.setdefault(each.keyframe, {})[each.landmark] = each
    unknown = np.diag(np.repeat([np.pi, sensor_range_m], 3) ** -2.0)
    return {
        keyframe: np.asarray(
            np.linalg.inv(unknown + _relative_information(seen.get(keyframe, {}), seen.get(anchor, {})))
        )
        for keyframe, anchor in anchors.items()
    }


def _relative_information(seen: Mapping[int, Observation], by_anchor: Mapping[int, Observation]) -> FloatArray:
    """Information (6, 6) that common landmarks hold on the pose of a keyframe relative to its anchor."""
    information = np.zeros((6, 6))
    for variable, each in seen.items():
        if (other := by_anchor.get(variable)) is None:
            continue
        noise = each.covariance_inflation * each.covariance
        noise = noise + other.covariance_inflation * np.trace(other.covariance) / 3.0 * np.eye(3)
        J = np.hstack([skew(each.position), -np.eye(3)])
        information += J.T @ np.linalg.solve(noise, J)
    return information
