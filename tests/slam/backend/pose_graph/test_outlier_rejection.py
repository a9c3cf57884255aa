"""Which closures are left out of the graph at the end of a drive."""

from __future__ import annotations

import numpy as np

from slam.backend.factors import Edge, EdgeKind, Factor, Observation, PosePrior
from slam.backend.pose_graph.outlier_rejection import reject_outlier_closures
from slam.common.arrays import FloatArray
from slam.common.geometry import transform_from_xyz_yaw

STEPS = 20
STEP_M = 2.0
ODOMETRY = np.diag(np.repeat([0.01**2, 0.05**2], 3))
CLOSURE = np.diag(np.repeat([0.02**2, 0.2**2], 3))


def at(x_m: float) -> FloatArray:
    return transform_from_xyz_yaw(np.array([x_m, 0.0, 0.0]), 0.0)


def street(*closures: tuple[int, int, float]) -> dict[int, Factor]:
    """A chain of keyframes, and closures from, to and wrong by so many metres; they are factors 100, 101, ..."""
    factors: dict[int, Factor] = {0: PosePrior(0, np.eye(4), 1e-3)}
    for number in range(STEPS):
        factors[1 + number] = Edge(number, number + 1, at(STEP_M), ODOMETRY, EdgeKind.ODOMETRY)
    for number, (first, last, off_m) in enumerate(closures):
        T = at(STEP_M * (last - first) + off_m)
        factors[100 + number] = Edge(first, last, T, CLOSURE, EdgeKind.LOOP_CLOSURE)
    return factors


def rejected(
    factors: dict[int, Factor], tested: list[int], inflation: float = 1.0, local: FloatArray | None = None
) -> list[int]:
    poses = dict(enumerate(at(STEP_M * number) for number in range(STEPS + 1)))
    T_local_body = poses if local is None else dict(enumerate(local))
    closures = [edge for number in tested if isinstance(edge := factors[number], Edge)]
    found = reject_outlier_closures(factors.values(), closures, poses, T_local_body, odometry_inflation=inflation)
    return [number for number, is_kept in zip(tested, found.kept, strict=True) if not is_kept]


def test_a_closure_that_disagrees_with_odometry_and_the_others_is_rejected():
    factors = street((0, 10, 0.1), (2, 12, -0.1), (5, 15, 0.0), (4, 18, 8.0))
    assert rejected(factors, [100, 101, 102, 103]) == [103]


def test_only_the_closures_named_take_part():
    factors = street((0, 10, 0.1), (2, 12, -0.1), (0, 10, 8.0), (2, 12, 8.0), (5, 15, 8.0), (4, 14, 8.0))
    assert rejected(factors, [100, 101]) == []


def test_landmarks_do_not_take_part():
    factors = street((0, 10, 0.1), (2, 12, 0.0)) | {
        200: Observation(0, 7, np.array([9.0, 1.0, 0.0]), 1e-6 * np.eye(3)),
        201: Observation(10, 7, np.array([9.0, 1.0, 0.0]), 1e-6 * np.eye(3)),
    }
    assert rejected(factors, [100, 101]) == []


def test_how_far_the_odometry_is_trusted_decides():
    factors = street((0, 20, 6.0), (1, 19, 5.5))
    assert rejected(factors, [100, 101], inflation=10.0) == []
    assert rejected(factors, [100, 101], inflation=0.1) == [100, 101]


def test_closures_across_a_slip_that_landmarks_show_are_kept():
    factors = street((0, 12, 2.0), (3, 15, 2.0))
    assert rejected(factors, [100, 101]) == [100, 101]
    corrected = np.stack([at(STEP_M * number + 2.0 * (number > 8)) for number in range(STEPS + 1)])
    assert rejected(factors, [100, 101], local=corrected) == []
