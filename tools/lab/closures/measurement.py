"""What false closures do to a trajectory: they are put into the graph of a drive whose true poses are known."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slam.backend.factors import EdgeKind
from slam.backend.pose_graph.pose_graph import PoseGraph, make_pose_graph
from slam.backend.pose_graph.pose_graph_optimization import optimize_pose_graph
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.common.geometry import invert, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import clean_poses
from slam.evaluation.metrics.alignment import align_path
from slam.evaluation.metrics.trajectory import compute_absolute_error
from slam.evaluation.place_recognition.revisits import find_true_poses
from tools.lab.closures.false_closures import KINDS, Closures, make_true_closures

TRUE_WITHIN_M = 2.0
TRUE_WITHIN_RAD = np.deg2rad(5.0)
"""A closure of the log that is farther from the truth is a false one."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosureDrive:
    """A drive of K keyframes with truth, in the order of time.

    keyframe_ids (K,); T_world_body_gt (K, 4, 4); odometry edges: ids (E, 2), transforms (E, 4, 4), covariances
    (E, 6, 6); ``closures`` are the log's own, the true ones among them, with rows of the keyframes as pairs.
    """

    keyframe_ids: IntArray
    T_world_body_gt: FloatArray
    odometry_ids: IntArray
    odometry_transforms: FloatArray
    odometry_covariances: FloatArray
    closures: Closures


@dataclass(frozen=True, slots=True)
class ClosureRun:
    """One solution. ``case``: "odometry", "clean", or a kind of false closures. Shares of none are None."""

    case: str
    all_false: bool
    seed: int
    closure_count: int
    ate_m: float
    true_kept_share: float | None
    false_kept_share: float | None
    seconds: float
    converged: bool
    message: str


def make_drive(records: EvaluationRecords) -> ClosureDrive:
    """The graph of a mapped log with its truth.

    Raises:
        EvaluationError: the log has no graph or no truth, or the truth does not cover all keyframes.
    """
    graph = records.graph
    if graph is None:
        raise EvaluationError("the log holds no graph (/slam/graph); give one that 'dslam replay' finished")
    truth = clean_poses(
        np.array([pose.stamp_ns for pose in records.true_poses], dtype=np.int64),
        np.array([pose.T_world_body for pose in records.true_poses]).reshape(-1, 4, 4),
    )
    order = np.argsort(graph.keyframe_stamps_ns, kind="stable")
    ids = graph.keyframe_ids[order]
    known, T_world_body = find_true_poses(truth, graph.keyframe_stamps_ns[order], max_gap_s=Protocol().max_truth_gap_s)
    if not known.all() or len(ids) < 3:
        raise EvaluationError(f"{np.count_nonzero(known)} of {len(ids)} keyframes have a true pose; all must have one")
    is_closure = np.array([kind == EdgeKind.LOOP_CLOSURE for kind in graph.edge_kinds], dtype=np.bool_)
    row_of = {keyframe: row for row, keyframe in enumerate(ids.tolist())}
    pairs = np.array([[row_of[i] for i in edge] for edge in graph.edge_keyframe_ids.tolist()], dtype=np.int64)
    T_true = invert(T_world_body[pairs[:, 0]]) @ T_world_body[pairs[:, 1]]
    T_error = invert(T_true) @ graph.edge_transforms
    right = (np.linalg.norm(T_error[:, :3, 3], axis=1) <= TRUE_WITHIN_M) & (
        rotation_angle_rad(T_error) <= TRUE_WITHIN_RAD
    )
    mine = is_closure & right
    return ClosureDrive(
        keyframe_ids=ids,
        T_world_body_gt=T_world_body,
        odometry_ids=graph.edge_keyframe_ids[~is_closure],
        odometry_transforms=graph.edge_transforms[~is_closure],
        odometry_covariances=graph.edge_covariances[~is_closure],
        closures=Closures(pairs[mine], graph.edge_transforms[mine], graph.edge_covariances[mine]),
    )


def benchmark_closures(
    drive: ClosureDrive, *, kinds: Sequence[str], false_share: float, seeds: int, spacing_m: float | None
) -> Iterator[ClosureRun]:
    """Solve with no closure, with the true ones, and with false ones of each kind: besides the true ones, and alone.

    Args:
        drive: as :func:`make_drive` makes it.
        kinds: of :data:`tools.lab.closures.false_closures.KINDS`.
        false_share: of all closures, in (0, 1).
        seeds: 0 to ``seeds`` - 1, of the noise and of the false closures.
        spacing_m: true closures are made from the truth, one each so many metres; None: the log's own.

    Raises:
        EvaluationError: there is no true closure.
    """
    no_closures = Closures(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))
    yield _run(drive, "odometry", 0, no_closures, no_closures)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        right = drive.closures if spacing_m is None else make_true_closures(drive.T_world_body_gt, spacing_m, rng)
        if len(right) == 0:
            raise EvaluationError(
                "the log has no true closure; make them from the truth by --from-truth 10"
                if spacing_m is None
                else "the drive has no revisit, so it has no true closure; give one that has"
            )
        yield _run(drive, "clean", seed, right, no_closures)
        for kind in kinds:
            count = max(1, round(len(right) * false_share / (1.0 - false_share)))
            wrong = KINDS[kind](drive.T_world_body_gt, count, np.random.default_rng([seed, list(KINDS).index(kind)]))
            yield _run(drive, kind, seed, right, wrong)
            yield _run(drive, kind, seed, no_closures, wrong)


def _run(drive: ClosureDrive, case: str, seed: int, right: Closures, wrong: Closures) -> ClosureRun:
    both = right.and_also(wrong)
    graph = _pose_graph(drive, both)
    is_closure = np.arange(len(graph.edges)) >= len(drive.odometry_ids)
    started = time.perf_counter()
    solved = optimize_pose_graph(graph, is_closure)
    seconds = time.perf_counter() - started
    positions = solved.graph.T_world_vertex[graph.rows_of(drive.keyframe_ids), :3, 3]
    truth = drive.T_world_body_gt[:, :3, 3]
    kept = solved.solution.kept
    return ClosureRun(
        case=case,
        all_false=len(right) == 0 and len(wrong) > 0,
        seed=seed,
        closure_count=len(both),
        ate_m=compute_absolute_error(positions, truth, align_path(positions, truth)).rmse_m,
        true_kept_share=float(np.mean(kept[: len(right)])) if len(right) else None,
        false_kept_share=float(np.mean(kept[len(right) :])) if len(wrong) else None,
        seconds=seconds,
        converged=solved.solution.converged,
        message=solved.solution.message,
    )


def _pose_graph(drive: ClosureDrive, closures: Closures) -> PoseGraph:
    """Odometry, then closures; every run starts from the odometry, whatever the log's own estimate was."""
    first = {int(drive.keyframe_ids[0]): np.eye(4)}
    chain = np.asarray(np.linalg.inv(drive.odometry_covariances), dtype=np.float64)
    odometry = make_pose_graph(first, drive.odometry_ids, drive.odometry_transforms, chain, np.zeros(0, dtype=np.int64))
    return PoseGraph(
        odometry.vertex_ids,
        odometry.T_world_vertex,
        np.concatenate([odometry.edges, drive.keyframe_ids[closures.pairs]]),
        np.concatenate([odometry.T_from_to, closures.T_reference_query]),
        np.concatenate([chain, np.linalg.inv(closures.covariances)]),
        odometry.fixed_ids,
    )
