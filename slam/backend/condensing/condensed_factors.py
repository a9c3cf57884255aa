"""The factors of attached keyframes, as factors of their anchors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from slam.backend.condensing.attached_keyframes import AttachedKeyframes
from slam.backend.factors import Edge, EdgeKind, Factor, Observation
from slam.backend.observation_sums import sum_observations
from slam.common.arrays import FloatArray
from slam.common.geometry import adjoint, invert, skew


def relative_covariances(
    observations: Iterable[tuple[int, Observation]],
    edges: Sequence[Edge],
    anchors: Mapping[int, int],
    *,
    sensor_range_m: float,
) -> dict[int, FloatArray]:
    """Covariance (6, 6) of the pose of each keyframe relative to its anchor, about the axes of the keyframe.

    By the landmarks that both observed, by closures, and along the drive by the odometry: a smoother of information, to
    which earlier keyframes are constants.

    Args:
        observations: all, with the variables of their landmarks.
        edges: all.
        anchors: of the keyframes in question.
        sensor_range_m: what is not known is off by that at most.
    """
    seen = dict[int, dict[int, Observation]]()
    for variable, each in observations:
        seen.setdefault(each.keyframe, {})[variable] = each
    none = np.diag(np.repeat([np.pi, sensor_range_m], 3) ** -2.0)
    own = {
        keyframe: none + _relative_information(seen.get(keyframe, {}), seen.get(anchor, {}))
        for keyframe, anchor in anchors.items()
    }
    for edge in edges:
        if edge.kind == EdgeKind.LOOP_CLOSURE and edge.to_keyframe in own:
            own[edge.to_keyframe] += np.linalg.inv(edge.covariance)
    steps = [
        edge
        for edge in sorted(edges, key=lambda each: each.to_keyframe)
        if edge.kind == EdgeKind.ODOMETRY and edge.from_keyframe in anchors and edge.to_keyframe in anchors
    ]
    from_before, from_after = dict[int, FloatArray](), dict[int, FloatArray]()
    for edge in steps:
        known = own[edge.from_keyframe] + from_before.get(edge.from_keyframe, 0.0)
        Ad = adjoint(invert(edge.T_from_to))
        from_before[edge.to_keyframe] = _inverse(Ad @ _inverse(known) @ Ad.T + edge.covariance)
    for edge in reversed(steps):
        known = own[edge.to_keyframe] + from_after.get(edge.to_keyframe, 0.0)
        Ad = adjoint(edge.T_from_to)
        from_after[edge.from_keyframe] = _inverse(Ad @ (_inverse(known) + edge.covariance) @ Ad.T)
    return {
        keyframe: _inverse(information + from_before.get(keyframe, 0.0) + from_after.get(keyframe, 0.0))
        for keyframe, information in own.items()
    }


def _inverse(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrix))


def _relative_information(seen: Mapping[int, Observation], by_anchor: Mapping[int, Observation]) -> FloatArray:
    """Information (6, 6) that common landmarks hold on the pose of a keyframe relative to its anchor."""
    information = np.zeros((6, 6))
    for variable, each in seen.items():
        other = by_anchor.get(variable)
        if other is None:
            continue
        noise = each.covariance_inflation * each.covariance
        noise = noise + other.covariance_inflation * np.trace(other.covariance) / 3.0 * np.eye(3)
        J = np.hstack([skew(each.position), -np.eye(3)])
        information += J.T @ np.linalg.solve(noise, J)
    return information


def condensed_factors(
    factors: Mapping[int, Factor], anchors: Mapping[int, int], attached: AttachedKeyframes
) -> tuple[list[int], list[Edge], list[Observation]]:
    """The factors that replace those of newly attached keyframes.

    Observations from them become observations from their anchors. Of their edges those to keyframes that stay remain,
    but for closures that found them: the anchor represents those.

    Args:
        factors: those in force, by number.
        anchors: of the keyframes that are newly attached.
        attached: all attached keyframes.

    Returns:
        Numbers of the factors that are no longer needed, the edges in their place, and observations from the anchors,
        not yet summed up.
    """
    standing = set(anchors.values())
    gone, edges, moved = list[int](), list[Edge](), list[Observation]()
    for number, factor in factors.items():
        match factor:
            case Observation() if factor.keyframe in anchors or factor.keyframe in standing:
                gone.append(number)
                moved.append(attached.observation(factor))
            case Edge() if factor.from_keyframe in anchors or factor.to_keyframe in anchors:
                gone.append(number)
                edge = attached.edge(factor)
                if _stays(factor, anchors) and edge.from_keyframe != edge.to_keyframe:
                    kind = EdgeKind.CONDENSED if factor.kind == EdgeKind.ODOMETRY else factor.kind
                    edges.append(Edge(edge.from_keyframe, edge.to_keyframe, edge.T_from_to, edge.covariance, kind))
    return gone, edges, moved


def summed_at_estimate(
    observations: Sequence[Observation], T_map_body: FloatArray, points_map: FloatArray, kernel_width: float
) -> list[Observation]:
    """Observations of one landmark from one keyframe as one, each with the weight that the robust kernel gives it.

    Args:
        observations: (N,).
        T_map_body: (N, 4, 4), the estimates of their keyframes.
        points_map: (N, 3) m, those of their landmarks.
        kernel_width: of the observations, in standard deviations.
    """
    if not observations:
        return []
    inflations = np.array([each.covariance_inflation for each in observations])
    covariances = np.array([each.covariance for each in observations])
    positions = np.array([each.position for each in observations])
    residuals = positions - np.einsum("nji,nj->ni", T_map_body[:, :3, :3], points_map - T_map_body[:, :3, 3])
    squares = np.einsum("ni,nij,nj->n", residuals, np.linalg.inv(covariances), residuals)
    weights = 1.0 / (1.0 + squares / kernel_width**2)
    return sum_observations(
        np.array([each.keyframe for each in observations]),
        np.array([each.landmark for each in observations]),
        positions,
        (inflations / weights)[:, None, None] * covariances,
        inflations,
    )


def _stays(edge: Edge, anchors: Mapping[int, int]) -> bool:
    """Whether an edge of attached keyframes still relates two variables that nothing else relates."""
    if edge.from_keyframe in anchors and edge.to_keyframe in anchors:
        return False
    return edge.kind != EdgeKind.LOOP_CLOSURE or edge.to_keyframe not in anchors
