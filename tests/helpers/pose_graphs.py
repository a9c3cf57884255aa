"""A drive of two rounds, as a pose graph: what several files of tests solve."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from slam.backend.pose_graph.pose_graph import PoseGraph
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw

ROUND = 60
VERTICES = 2 * ROUND
ODOMETRY_SIGMAS = np.repeat([0.003, 0.03], 3)
CLOSURE_SIGMAS = np.repeat([0.01, 0.1], 3)


def true_poses() -> FloatArray:
    """(VERTICES, 4, 4): twice around a circle of 20 m radius, a little higher the second time."""
    angle = 2.0 * np.pi * np.arange(VERTICES) / ROUND
    xyz = np.column_stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), 0.01 * np.arange(VERTICES)])
    return transform_from_xyz_yaw(xyz, angle + 0.5 * np.pi)


def noise(count: int, sigmas: FloatArray, rng: np.random.Generator) -> FloatArray:
    errors = rng.normal(size=(count, 6)) * sigmas
    return make_transform(Rotation.from_rotvec(errors[:, :3]).as_matrix(), errors[:, 3:])


def two_rounds(closures: IntArray, T_from_to: FloatArray, *, seed: int = 0) -> PoseGraph:
    """Noisy odometry, which places the vertices, then the closures (C, 2) with their measurements (C, 4, 4)."""
    T_gt = true_poses()
    steps = invert(T_gt[:-1]) @ T_gt[1:] @ noise(VERTICES - 1, ODOMETRY_SIGMAS, np.random.default_rng(seed))
    poses = [T_gt[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    ids = np.arange(VERTICES)
    return PoseGraph(
        T_world_vertex=np.array(poses),
        edges=np.concatenate([np.column_stack([ids[:-1], ids[1:]]), closures]),
        T_from_to=np.concatenate([steps, T_from_to]),
        covariances=np.concatenate(
            [
                np.tile(np.diag(ODOMETRY_SIGMAS**2), (len(steps), 1, 1)),
                np.tile(np.diag(CLOSURE_SIGMAS**2), (len(closures), 1, 1)),
            ]
        ),
    )


def true_closures(count: int, rng: np.random.Generator) -> tuple[IntArray, FloatArray]:
    """From the first round to the second, evenly spread."""
    start = np.linspace(0, ROUND - 1, count).astype(np.int64)
    pairs = np.column_stack([start, start + ROUND])
    T_gt = true_poses()
    return pairs, invert(T_gt[pairs[:, 0]]) @ T_gt[pairs[:, 1]] @ noise(count, CLOSURE_SIGMAS, rng)


def false_closures(count: int, rng: np.random.Generator) -> tuple[IntArray, FloatArray]:
    """Opposite places of the circle that are said to be one, more or less."""
    start = rng.integers(0, ROUND, count)
    end = start + ROUND // 2 + rng.integers(-10, 10, count)
    yaw = rng.choice([0.0, np.pi], count)
    xyz = np.column_stack([rng.uniform(-3.0, 3.0, (count, 2)), np.zeros(count)])
    return np.column_stack([start, end]), transform_from_xyz_yaw(xyz, yaw)


def with_false(true_count: int, false_count: int, *, seed: int = 1) -> PoseGraph:
    """The drive with true closures, then false ones."""
    rng = np.random.default_rng(seed)
    parts = (true_closures(true_count, rng), false_closures(false_count, rng))
    pairs, transforms = (np.concatenate(part) for part in zip(*parts, strict=True))
    return two_rounds(pairs, transforms)


def are_closures(graph: PoseGraph) -> BoolArray:
    """Which edges (E,) of a drive are closures: all after the odometry."""
    return np.asarray(np.arange(len(graph.edges)) >= VERTICES - 1)


def rmse_m(graph: PoseGraph) -> float:
    """Distance from the truth; the first vertex is held there, so nothing need be aligned."""
    return float(np.sqrt(np.mean(np.sum((graph.T_world_vertex - true_poses())[:, :3, 3] ** 2, axis=1))))
