"""Factors between keyframes and landmarks: records of our own, and the GTSAM factors that they become.

Records are summed up here, and rewritten where their keyframe moves with another one. Everything is checked before
GTSAM sees it, since GTSAM does not check that a rotation matrix is one. Noise in GTSAM's order: rotation, then
translation.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import E, L, X

from logs.records import frozen
from slam.backend.edge_kind import EdgeKind as EdgeKind
from slam.common.arrays import FloatArray, IntArray, least_eigenvalues
from slam.common.errors import FactorGraphError
from slam.common.geometry import adjoint, invert

EARTH = -1
"""The frame of fixes, upright, from which edges lead as from a keyframe."""
PRIOR_SIGMA_RAD = 1e-4
OBSERVATION_KERNEL_WIDTH = 1.5
KERNEL_WIDTHS = {EdgeKind.LOOP_CLOSURE: 1.0, EdgeKind.GNSS: 1.0, EdgeKind.ODOMETRY: 4.0}
"""Widths of the Cauchy kernels, in standard deviations. A step of the odometry, which has 6 coordinates, so has
Student's t-distribution with 4^2 - 6 = 10 degrees of freedom (Lange et al. 1989): a jump is rare, but possible.
"""


@frozen
class Edge:
    """A between-factor: ``T_from_to`` (4, 4) with its covariance (6, 6); ValueError if ``kind`` is no ``EdgeKind``.

    ``is_gaussian``: whether its error is taken to be Gaussian, as tests need it, instead of having the heavy tails of
    its kind.
    """

    from_keyframe: int
    to_keyframe: int
    T_from_to: FloatArray
    covariance: FloatArray
    kind: EdgeKind
    is_gaussian: bool = False


@frozen
class Observation:
    """A landmark seen from a keyframe: ``position`` (3,) m in the keyframe's body frame, covariance (3, 3) m^2.

    ``covariance_inflation``: factor on the covariance for errors that observations share (effective sample size).
    """

    keyframe: int
    landmark: int
    position: FloatArray
    covariance: FloatArray
    covariance_inflation: float = 1.0


Factor = Edge | Observation


def pose_key(keyframe: int) -> int:
    """GTSAM's key of the pose of a keyframe, or of the frame of fixes."""
    return E(0) if keyframe == EARTH else X(keyframe)


def prior_factor(keyframe: int, pose: gtsam.Pose3, sigmas: FloatArray) -> gtsam.NonlinearFactor:
    """The GTSAM factor of the pose of a keyframe, or of the frame of fixes, with standard deviations (6,)."""
    return gtsam.PriorFactorPose3(pose_key(keyframe), pose, gtsam.noiseModel.Diagonal.Sigmas(sigmas))


def between_factor(edge: Edge, T_map_from: FloatArray | None = None) -> gtsam.NonlinearFactor:
    """The GTSAM factor of an edge.

    ``T_map_from`` (4, 4): of a keyframe that is a constant.
    """
    what = f"edge {edge.from_keyframe} -> {edge.to_keyframe}"
    _check_covariances(edge.covariance[None], lambda _: what)
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
    if edge.kind in KERNEL_WIDTHS and not edge.is_gaussian:
        width = KERNEL_WIDTHS[edge.kind]
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(width), noise)
    pose = checked_pose(edge.T_from_to, what)
    if T_map_from is not None:
        return gtsam.PriorFactorPose3(X(edge.to_keyframe), gtsam.Pose3(T_map_from).compose(pose), noise)
    return gtsam.BetweenFactorPose3(pose_key(edge.from_keyframe), X(edge.to_keyframe), pose, noise)


def observation_factors(
    observations: Sequence[Observation], kernel_width: float, *, sensor_range_m: float
) -> list[gtsam.NonlinearFactor]:
    """The GTSAM factors of observations: the error is that of the position in the body frame, with its covariance.

    GTSAM has no such factor. A stereo camera that looks up from so far below the body that rays are parallel, with that
    distance as its focal length and its baseline, sees a point (x, y, z) at uL = x, uR = x + z - distance, v = y. (A
    factor of bearing and range would not do: the tangent plane of its bearing has axes that jump, so that it cannot
    tell a sure azimuth from an unsure height.)
    """
    _, _, positions, covariances, inflations = stacked(observations)
    _check_covariances(covariances, lambda row: _name(observations[row]))
    for row in np.flatnonzero(~np.isfinite(positions).all(axis=1)).tolist():
        raise FactorGraphError(f"{_name(observations[row])}: the position {positions[row]} is not finite")
    left_right_up = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    noises = inflations[:, None, None] * (left_right_up @ covariances @ left_right_up.T)
    # The width of the kernel is in standard deviations of one observation, before the inflation.
    widths = kernel_width / np.sqrt(inflations)
    kernels = {width: gtsam.noiseModel.mEstimator.Cauchy.Create(width) for width in set(widths.tolist())}
    distance_m = 1e6 * sensor_range_m
    camera = gtsam.Cal3_S2Stereo(distance_m, distance_m, 0.0, 0.0, 0.0, distance_m)
    T_body_camera = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -distance_m]))
    scales = distance_m / (distance_m + positions[:, 2])
    lefts, ups = scales * positions[:, 0], scales * positions[:, 1]
    pixels = np.column_stack([lefts, lefts - scales * distance_m, ups])
    return [
        gtsam.GenericStereoFactor3D(
            gtsam.StereoPoint2(*pixel),
            gtsam.noiseModel.Robust.Create(kernels[width], gtsam.noiseModel.Gaussian.Covariance(noise)),
            X(each.keyframe),
            L(each.landmark),
            camera,
            T_body_camera,
        )
        for each, pixel, noise, width in zip(observations, pixels.tolist(), noises, widths.tolist(), strict=True)
    ]


def sum_observations(
    keyframes: IntArray, landmarks: IntArray, positions: FloatArray, covariances: FloatArray, inflations: FloatArray
) -> list[Observation]:
    """One observation for each keyframe and landmark, ascending.

    Information adds up. The inflation is divided by the number of observations, so that the robust kernel stays as
    wide as for one of them.

    Args:
        keyframes: (N,) ids.
        landmarks: (N,) ids.
        positions: (N, 3) m in the frames of the keyframes.
        covariances: (N, 3, 3) m^2, inflated.
        inflations: (N,), of which the covariances are multiples.
    """
    pairs, rows = np.unique(np.stack([keyframes, landmarks], axis=1), axis=0, return_inverse=True)
    rows = rows.reshape(-1)
    information = np.linalg.inv(covariances)
    summed, weighted = np.zeros((len(pairs), 3, 3)), np.zeros((len(pairs), 3))
    np.add.at(summed, rows, information)
    np.add.at(weighted, rows, np.einsum("nij,nj->ni", information, positions))
    sums = np.linalg.inv(summed)
    means = np.einsum("nij,nj->ni", sums, weighted)
    shares = np.bincount(rows, inflations) / np.bincount(rows) ** 2
    return [
        Observation(keyframe, landmark, mean, covariance, inflation)
        for (keyframe, landmark), mean, covariance, inflation in zip(
            pairs.tolist(), means, sums / shares[:, None, None], shares.tolist(), strict=True
        )
    ]


def stacked(observations: Sequence[Observation]) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
    """Keyframes (N,), landmarks (N,), positions (N, 3) m, covariances (N, 3, 3) m^2 and their inflations (N,)."""
    return (
        np.array([each.keyframe for each in observations], dtype=np.int64),
        np.array([each.landmark for each in observations], dtype=np.int64),
        np.array([each.position for each in observations]).reshape(-1, 3),
        np.array([each.covariance for each in observations]).reshape(-1, 3, 3),
        np.array([each.covariance_inflation for each in observations], dtype=np.float64),
    )


def checked_pose(T: FloatArray, what: str) -> gtsam.Pose3:
    """A rigid transform (4, 4) as GTSAM's; ``what`` it is goes into the error."""
    R = T[:3, :3]
    if not np.all(np.isfinite(T)) or np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:
        raise FactorGraphError(f"{what}: not a rigid transform: {np.array2string(T, precision=4)}")
    return gtsam.Pose3(T)


def _check_covariances(covariances: FloatArray, name_of: Callable[[int], str]) -> None:
    """Refuse wrong ones of covariances (N, n, n), by name."""
    for row in np.flatnonzero(least_eigenvalues(covariances) <= 0.0).tolist():
        raise FactorGraphError(f"{name_of(row)}: the covariance is not finite and positive definite")


def _name(observation: Observation) -> str:
    return f"observation of landmark {observation.landmark} from keyframe {observation.keyframe}"


class AttachedKeyframes:
    """Keyframes that are not variables of the graph, as each moves rigidly with another one, its anchor: rewrites their
    factors as factors of anchors.
    """

    def __init__(self) -> None:
        self.anchors: dict[int, int] = {}
        """The anchor of each attached keyframe."""
        self.transforms: dict[int, FloatArray] = {}
        """The pose (4, 4) of each in the frame of its anchor."""
        self.covariances: dict[int, FloatArray] = {}
        """Of the pose (6, 6) of each attached keyframe, as it was when it was attached."""

    def attach(
        self, anchors: Mapping[int, int], covariances: Mapping[int, FloatArray], pose: Callable[[int], FloatArray]
    ) -> None:
        """Attach keyframes to their anchors, which stay variables, as their poses (4, 4) in the map are now, with
        ``covariances`` (6, 6).
        """
        self.covariances |= covariances
        self.transforms |= {each: invert(pose(anchor)) @ pose(each) for each, anchor in anchors.items()}
        self.anchors |= anchors

    def edge(self, edge: Edge) -> Edge:
        """The same constraint between anchors; covariances are about the axes of the keyframe that it leads to."""
        T_from_to, covariance = edge.T_from_to, edge.covariance
        start, end = edge.from_keyframe, edge.to_keyframe
        if start in self.anchors:
            T_from_to = self.transforms[start] @ T_from_to
        if end in self.anchors:
            Ad = adjoint(self.transforms[end])
            covariance = Ad @ covariance @ Ad.T
            T_from_to = T_from_to @ invert(self.transforms[end])
        return replace(
            edge,
            from_keyframe=self.anchors.get(start, start),
            to_keyframe=self.anchors.get(end, end),
            T_from_to=T_from_to,
            covariance=covariance,
        )

    def observation(self, observation: Observation) -> Observation:
        """The same observation from the anchor."""
        if observation.keyframe not in self.anchors:
            return observation
        T = self.transforms[observation.keyframe]
        return replace(
            observation,
            keyframe=self.anchors[observation.keyframe],
            position=T[:3, :3] @ observation.position + T[:3, 3],
            covariance=T[:3, :3] @ observation.covariance @ T[:3, :3].T,
        )
