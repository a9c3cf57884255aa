"""How well and how fast constellations are registered, beside Open3D and KISS-Matcher on the same correspondences."""

from __future__ import annotations

import importlib
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert, rotation_angle_rad, transform_from_xyz_yaw
from slam.registration.parameters import RegistrationConfig
from slam.registration.registration import register
from slam.sweeps.workers import Death, compute_all

CORRESPONDENCES = (50, 100, 500, 1000, 5000)
FALSE_SHARES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99)

NOISE_M = 0.2
"""Of the query's positions, along each axis."""
GATE_M = 3.0 * NOISE_M
"""What the peers take as the largest distance of two points that correspond."""
SUCCESS_M, SUCCESS_DEG = 1.0, 2.0
MANY = 2000
"""With so many correspondences a quarter of the trials is enough."""

Solver = Callable[["Problem", int], FloatArray | None]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Query (N, 3) and reference (M, 3) objects, metres; correspondences (C, 2); the truth, (4, 4)."""

    query: FloatArray
    reference: FloatArray
    correspondences: IntArray
    T_reference_query_gt: FloatArray

    def error(self, T_reference_query: FloatArray) -> tuple[float, float]:
        """Metres at the centre of the query's objects, and degrees."""
        centre = self.query.mean(axis=0, keepdims=True)
        offset = apply(T_reference_query, centre) - apply(self.T_reference_query_gt, centre)
        turn = rotation_angle_rad(invert(self.T_reference_query_gt) @ T_reference_query)
        return float(np.linalg.norm(offset)), float(np.degrees(turn))


@dataclass(frozen=True, slots=True)
class Cell:
    """One method on one kind of problem; errors are medians of the successful trials, None without any."""

    method: str
    correspondences: int
    false_share: float
    true_correspondences: int
    trials: int
    success: float
    median_error_m: float | None
    median_error_deg: float | None
    median_ms: float
    fastest_ms: float


@dataclass(frozen=True, slots=True)
class RegistrationBenchmark:
    """All cells, and for each peer that cannot be imported the reason."""

    cells: tuple[Cell, ...]
    unavailable: dict[str, str]


def benchmark_registration(
    *, seed: int, trials: int, correspondences: Sequence[int] = CORRESPONDENCES
) -> RegistrationBenchmark:
    """All methods that can be imported on the same problems, drawn from ``seed``.

    Each in a process of its own, one after the other and on one thread: threads of several libraries wait for one
    another, and a busy core would decide the result.
    """
    cells: list[Cell] = []
    unavailable: dict[str, str] = {}
    tasks = [(method, seed, trials, tuple(correspondences)) for method in METHODS]
    for (method, *_), outcome in compute_all(_measure_method, tasks, jobs=1, fresh=True):
        match outcome:
            case Death():
                unavailable[method] = f"its process ended with {outcome.exit_code}"
            case str():
                unavailable[method] = outcome
            case _:
                cells += outcome
    by_problem = sorted(cells, key=lambda c: (c.correspondences, c.false_share))
    return RegistrationBenchmark(tuple(by_problem), unavailable)


def _measure_method(task: tuple[str, int, int, tuple[int, ...]]) -> list[Cell] | str:
    """The cells of a method, or why it cannot be imported."""
    try:
        return measure_method(*task)
    except ImportError as error:
        return str(error)


def measure_method(method: str, seed: int, trials: int, correspondences: Sequence[int]) -> list[Cell]:
    """The cells of one of ``METHODS``.

    Raises:
        ImportError: the peer is not installed, or cannot be loaded.
    """
    solver = METHODS[method]()
    cells = []
    for count in correspondences:
        runs = trials if count < MANY else max(trials // 4, 1)
        for false_share in FALSE_SHARES:
            keys = [(seed, count, round(1000 * false_share), trial) for trial in range(runs)]
            problems = [draw_problem(count, false_share, rng=np.random.default_rng(key)) for key in keys]
            cells.append(_measure(method, solver, problems, count, false_share))
    return cells


def street_objects(count: int, *, rng: np.random.Generator) -> FloatArray:
    """Objects (``count``, 3), metres, on both sides of the streets of a square grid, a block 100 m, z up."""
    block_m, setback_m, objects_a_block = 100.0, 7.0, 16
    blocks = max(int(np.ceil(np.sqrt(count / (2 * objects_a_block)))), 1)
    along = rng.uniform(0.0, blocks * block_m, count)
    street = rng.integers(0, blocks, count) * block_m
    across = street + setback_m * rng.choice([-1.0, 1.0], count) + rng.normal(0.0, 0.5, count)
    is_east = rng.random(count) < 0.5
    planar = np.where(is_east[:, None], np.stack([along, across], axis=1), np.stack([across, along], axis=1))
    return np.column_stack([planar, rng.uniform(0.0, 3.0, count)])


def draw_problem(correspondences: int, false_share: float, *, rng: np.random.Generator) -> Problem:
    """A submap somewhere in a larger map: each true correspondence has its own objects, false ones any two."""
    true = round(correspondences * (1.0 - false_share))
    objects = max(true, correspondences // 10, 10)
    reference = street_objects(4 * objects, rng=rng)
    place = reference[rng.integers(len(reference))]
    seen = np.argsort(np.linalg.norm(reference[:, :2] - place[:2], axis=1))[:objects]
    T_reference_query = transform_from_xyz_yaw(place + rng.normal(0.0, 5.0, 3), rng.uniform(-np.pi, np.pi))
    query = apply(invert(T_reference_query), reference[seen]) + rng.normal(0.0, NOISE_M, (objects, 3))
    right = rng.permutation(objects)[:true]
    false = correspondences - true
    wrong_query = rng.integers(0, objects, false)
    # Any but the true one: as many places further on, around the end.
    wrong_reference = (seen[wrong_query] + rng.integers(1, len(reference), false)) % len(reference)
    pairs = np.concatenate([np.stack([right, seen[right]], axis=1), np.stack([wrong_query, wrong_reference], axis=1)])
    return Problem(query, reference, rng.permutation(pairs), T_reference_query)


def _measure(name: str, solver: Solver, problems: list[Problem], count: int, false_share: float) -> Cell:
    times_s, errors = [], []
    solver(problems[0], 0)  # what is loaded at the first call is not measured
    for trial, problem in enumerate(problems):
        start = time.perf_counter()
        T_reference_query = solver(problem, trial)
        times_s.append(time.perf_counter() - start)
        if T_reference_query is not None:
            errors.append(problem.error(T_reference_query))
    right = [(metres, degrees) for metres, degrees in errors if metres < SUCCESS_M and degrees < SUCCESS_DEG]
    return Cell(
        method=name,
        correspondences=count,
        false_share=false_share,
        true_correspondences=round(count * (1.0 - false_share)),
        trials=len(problems),
        success=len(right) / len(problems),
        median_error_m=statistics.median(metres for metres, _ in right) if right else None,
        median_error_deg=statistics.median(degrees for _, degrees in right) if right else None,
        median_ms=1e3 * statistics.median(times_s),
        fastest_ms=1e3 * min(times_s),
    )


def _ours() -> Solver:
    # The simulated heights are as good as the positions, and the frames are level: what the peers assume, too.
    config = RegistrationConfig(height_sigma_m=0.05, tilt_sigma_rad=0.001)

    def solve(problem: Problem, seed: int) -> FloatArray | None:
        return register(
            problem.query,
            problem.reference,
            problem.correspondences,
            config,
            query_sigmas=np.full(len(problem.query), NOISE_M),
            reference_sigmas=np.full(len(problem.reference), 0.05),
        )[0].T_reference_query

    return solve


def _open3d() -> Solver:
    """RANSAC on triples with both of its checks, at its default of 100,000 iterations."""
    open3d: Any = importlib.import_module("open3d")
    registration = open3d.pipelines.registration

    def cloud(points: FloatArray) -> Any:
        return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))

    def solve(problem: Problem, seed: int) -> FloatArray | None:
        open3d.utility.random.seed(seed)
        result = registration.registration_ransac_based_on_correspondence(
            cloud(problem.query),
            cloud(problem.reference),
            open3d.utility.Vector2iVector(problem.correspondences.astype(np.int32)),
            GATE_M,
            registration.TransformationEstimationPointToPoint(False),
            3,
            [
                registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                registration.CorrespondenceCheckerBasedOnDistance(GATE_M),
            ],
            registration.RANSACConvergenceCriteria(100_000, 0.999),
        )
        return np.asarray(result.transformation, dtype=np.float64) if len(result.correspondence_set) else None

    return solve


def _kiss_matcher(*, use_quatro: bool) -> Solver:
    """Graph-theoretic pruning and GNC on the given correspondences; quatro estimates yaw only, as ours."""
    kiss_matcher: Any = importlib.import_module("kiss_matcher")
    config = kiss_matcher.KISSMatcherConfig(voxel_size=GATE_M, use_quatro=use_quatro)

    def solve(problem: Problem, seed: int) -> FloatArray | None:
        matcher = kiss_matcher.KISSMatcher(config)
        query, reference = problem.correspondences.T
        solution = matcher.prune_and_solve(
            list(problem.query[query].astype(np.float32)), list(problem.reference[reference].astype(np.float32))
        )
        if not solution.valid:
            return None
        T_reference_query = np.eye(4)
        T_reference_query[:3, :3] = solution.rotation
        T_reference_query[:3, 3] = np.ravel(solution.translation)
        return T_reference_query if np.isfinite(T_reference_query).all() else None

    return solve


METHODS: dict[str, Callable[[], Solver]] = {
    "dslam": _ours,
    "Open3D": _open3d,
    "KISS-Matcher": partial(_kiss_matcher, use_quatro=False),
    "KISS-Matcher quatro": partial(_kiss_matcher, use_quatro=True),
}
