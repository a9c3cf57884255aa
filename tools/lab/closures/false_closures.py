"""Loop closures for a drive whose true poses are known: true ones, and three kinds of false ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw, travelled_m

SIGMA_RAD = np.deg2rad(0.5)
SIGMA_M = 0.3
SIGMAS = np.repeat([SIGMA_RAD, SIGMA_M], 3)
"""Noise of the closures that are made here, rotation first."""
REVISIT_M = 5.0
"""True closures are between poses that are no farther apart."""
MIN_TRAVEL_M = 100.0
"""Closures are between poses with more travel in between."""
WRONG_M = 15.0
"""False closures, other than shifted ones, are between poses that are farther apart."""
ALIASED_M = (20.0, 40.0)
SHIFT_M = (5.0, 20.0)
MAX_TRIES = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Closures:
    """C closures: pairs (C, 2) rows (reference, query) of poses, T_reference_query (C, 4, 4), covariances (C, 6, 6)."""

    pairs: IntArray
    T_reference_query: FloatArray
    covariances: FloatArray

    def __len__(self) -> int:
        return len(self.pairs)

    def and_also(self, others: Closures) -> Closures:
        """These, then the others."""
        return Closures(
            np.concatenate([self.pairs, others.pairs]),
            np.concatenate([self.T_reference_query, others.T_reference_query]),
            np.concatenate([self.covariances, others.covariances]),
        )


def make_true_closures(T_world_body_gt: FloatArray, spacing_m: float, rng: np.random.Generator) -> Closures:
    """A closure with the nearest earlier pose at each revisit, one each ``spacing_m`` of travel, with noise.

    Args:
        T_world_body_gt: (N, 4, 4) true poses in the order of time.
        spacing_m: least travel from one query to the next.
        rng: of the noise.
    """
    return _closures(T_world_body_gt, find_revisits(T_world_body_gt, spacing_m), rng)


def find_revisits(T_world_body_gt: FloatArray, spacing_m: float) -> IntArray:
    """Rows (C, 2) (reference, query): the nearest pose within 5 m that more than 100 m of travel lead back to."""
    travel_m, positions = travelled_m(T_world_body_gt), T_world_body_gt[:, :3, 3]
    tree = cKDTree(positions)
    pairs: list[tuple[int, int]] = []
    last_m = -np.inf
    for query, position in enumerate(positions):
        nearby = np.array(tree.query_ball_point(position, REVISIT_M), dtype=np.int64)
        earlier = np.sort(nearby[travel_m[query] - travel_m[nearby] > MIN_TRAVEL_M])
        if len(earlier) and travel_m[query] - last_m >= spacing_m:
            distances = np.linalg.norm(positions[earlier] - positions[query], axis=1)
            pairs.append((int(earlier[np.argmin(distances)]), query))
            last_m = float(travel_m[query])
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def make_random_closures(T_world_body_gt: FloatArray, count: int, rng: np.random.Generator) -> Closures:
    """Two poses taken at random, said to be within 3 m of one another, heading the same way or the opposite one."""
    pairs = np.array([_draw_apart(T_world_body_gt, rng) for _ in range(count)], dtype=np.int64).reshape(-1, 2)
    radius, angle = 3.0 * np.sqrt(rng.random(count)), rng.uniform(0.0, 2.0 * np.pi, count)
    xyz = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)])
    yaw = rng.choice([0.0, np.pi], count) + rng.normal(0.0, np.deg2rad(5.0), count)
    return _stack(pairs, transform_from_xyz_yaw(xyz, yaw) @ _noise(count, rng))


def make_aliased_closures(T_world_body_gt: FloatArray, count: int, rng: np.random.Generator) -> Closures:
    """Stretches of 20 to 40 m, each pose of which is found in one wrong stretch, where all of them agree.

    A stretch ends early where the wrong street bends away from it.

    Raises:
        EvaluationError: no two stretches of the drive are alike enough.
    """
    found = Closures(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))
    tries = 0
    while len(found) < count:
        stretch = _aliased_stretch(T_world_body_gt, rng)
        tries = 0 if len(stretch) else tries + 1
        if tries > MAX_TRIES:
            raise EvaluationError("no two stretches of this drive are alike, so none can be taken for another")
        found = found.and_also(stretch)
    return Closures(found.pairs[:count], found.T_reference_query[:count], found.covariances[:count])


def make_shifted_closures(T_world_body_gt: FloatArray, count: int, rng: np.random.Generator) -> Closures:
    """Closures at true revisits, each wrong by 5 to 20 m along the street, forward or back.

    Raises:
        EvaluationError: the drive comes back to no place.
    """
    revisits = find_revisits(T_world_body_gt, 0.0)
    if len(revisits) == 0:
        raise EvaluationError("the drive has no revisit, so no closure can be shifted")
    rows = np.sort(rng.choice(len(revisits), size=count, replace=count > len(revisits)))
    shifts = np.tile(np.eye(4), (count, 1, 1))
    shifts[:, 0, 3] = rng.uniform(*SHIFT_M, count) * rng.choice([-1.0, 1.0], count)
    right = _closures(T_world_body_gt, revisits[rows], rng)
    return Closures(right.pairs, shifts @ right.T_reference_query, right.covariances)


KINDS: dict[str, Callable[[FloatArray, int, np.random.Generator], Closures]] = {
    "random": make_random_closures,
    "aliased": make_aliased_closures,
    "shifted": make_shifted_closures,
}


def _aliased_stretch(T_world_body_gt: FloatArray, rng: np.random.Generator) -> Closures:
    """Closures of one stretch; none if the two streets do not run alike for 10 m."""
    travel_m = travelled_m(T_world_body_gt)
    reference, query = _draw_apart(T_world_body_gt, rng)
    end_m = travel_m[query] + rng.uniform(*ALIASED_M)
    queries = np.flatnonzero((travel_m >= travel_m[query]) & (travel_m <= end_m))
    yaw = float(rng.choice([0.0, np.pi]) + rng.normal(0.0, np.deg2rad(2.0)))
    T_reference_query = transform_from_xyz_yaw(np.array([*rng.uniform(-1.0, 1.0, 2), 0.0]), yaw)
    T_world_alias = T_world_body_gt[reference] @ T_reference_query @ invert(T_world_body_gt[query])
    T_wrong = T_world_alias @ T_world_body_gt[queries]
    nearby = np.flatnonzero(np.abs(travel_m - travel_m[reference]) <= ALIASED_M[1] + REVISIT_M)
    distances, nearest = cKDTree(T_world_body_gt[nearby, :3, 3]).query(T_wrong[:, :3, 3])
    references = nearby[nearest]
    alike = (distances <= REVISIT_M) & (travel_m[queries] - travel_m[references] > MIN_TRAVEL_M)
    length = int(np.argmin(np.append(alike, False)))
    if travel_m[queries[length - 1]] - travel_m[query] < 0.5 * ALIASED_M[0] or length == 0:
        length = 0
    pairs = np.column_stack([references[:length], queries[:length]])
    wrong = invert(T_world_body_gt[references[:length]]) @ T_wrong[:length]
    return _stack(pairs, wrong @ _noise(length, rng))


def _draw_apart(T_world_body_gt: FloatArray, rng: np.random.Generator) -> tuple[int, int]:
    """Rows (reference, query), the query later, of two poses in different places."""
    travel_m, positions = travelled_m(T_world_body_gt), T_world_body_gt[:, :3, 3]
    for _ in range(MAX_TRIES):
        reference, query = sorted(rng.integers(len(positions), size=2).tolist())
        far = np.linalg.norm(positions[query] - positions[reference]) > WRONG_M
        if far and travel_m[query] - travel_m[reference] > MIN_TRAVEL_M:
            return reference, query
    raise EvaluationError(f"{travel_m[-1]:.0f} m of travel are too little for closures over {MIN_TRAVEL_M:.0f} m")


def _closures(T_world_body_gt: FloatArray, pairs: IntArray, rng: np.random.Generator) -> Closures:
    reference, query = pairs.T
    return _stack(pairs, invert(T_world_body_gt[reference]) @ T_world_body_gt[query] @ _noise(len(pairs), rng))


def _stack(pairs: IntArray, T_reference_query: FloatArray) -> Closures:
    return Closures(pairs, T_reference_query, np.tile(np.diag(SIGMAS**2), (len(pairs), 1, 1)))


def _noise(count: int, rng: np.random.Generator) -> FloatArray:
    """Transforms (count, 4, 4) near the identity."""
    errors = rng.normal(size=(count, 6)) * SIGMAS
    return make_transform(Rotation.from_rotvec(errors[:, :3]).as_matrix(), errors[:, 3:])
