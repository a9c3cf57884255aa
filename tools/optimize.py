"""dslam optimize."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import Json, check_outputs

if TYPE_CHECKING:
    from slam.backend.pose_graph.pose_graph_optimization import PoseGraphSolution

NOT_CONVERGED = 1


def optimize(
    source: Annotated[Path, typer.Argument(metavar="IN.g2o", help="The pose graph to read.", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.g2o", help="The pose graph to write.")],
    plain: Annotated[bool, typer.Option("--plain", help="Keep all closures: ordinary least squares.")] = False,
    json: Json = False,
) -> None:
    """Optimise a pose graph (g2o, SE(2) or SE(3)) in which loop closures may be false.

    Edges between consecutive ids are odometry; so is the first edge between two parts that these do not connect. All
    other edges are closures, and each gets a weight from 0 (false) to 1, in OUT.json. OUT.g2o has the vertices at their
    solution and all edges as they were. Lines other than VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT and FIX
    are ignored.
    Exit code 1: no convergence; the files are written all the same.

    Example: dslam optimize graph.g2o -o optimized.g2o
    """
    check_outputs([output], [source])
    weights = output.with_suffix(".json")
    check_outputs([output, weights], [source])
    import numpy as np

    from logs.storage.placement import write_text
    from slam.backend.pose_graph.pose_graph_optimization import optimize_pose_graph
    from slam.formats.g2o import read_pose_graph, write_pose_graph
    from tools import console

    file = read_pose_graph(source)
    is_closure = file.graph.find_closures()
    solved = optimize_pose_graph(file.graph, np.zeros_like(is_closure) if plain else is_closure)
    summary = _summarize(solved)
    write_pose_graph(output, solved.graph)
    write_text(weights, _to_json({**summary, "closures": _closures(solved)}) + "\n")
    if json:
        console.show_json({"output": str(output), "weights": str(weights), **summary, "passed_over": file.passed_over})
    else:
        _show(summary, file.passed_over, f"{output}, {weights}")
    if not solved.solution.converged:
        sys.stdout.flush()
        print(f"dslam: not converged: {solved.solution.message}", file=sys.stderr)
        raise typer.Exit(NOT_CONVERGED)


def _summarize(solved: PoseGraphSolution) -> dict[str, Any]:
    solution = solved.solution
    kept = int(solution.kept.sum())
    return {
        "dimension": 2 if solved.graph.is_planar else 3,
        "vertex_count": len(solved.graph.vertex_ids),
        "edge_count": len(solved.graph.edges),
        "closure_count": len(solution.weights),
        "kept_count": kept,
        "rejected_count": len(solution.weights) - kept,
        "error_before": solution.error_before,
        "error_after": solution.error_after,
        "iterations": solution.iterations,
        "converged": solution.converged,
        "message": solution.message,
    }


def _closures(solved: PoseGraphSolution) -> list[dict[str, Any]]:
    solution, edges = solved.solution, solved.graph.edges[solved.is_closure].tolist()
    return [
        {"from": start, "to": end, "weight": weight, "kept": kept}
        for (start, end), weight, kept in zip(edges, solution.weights.tolist(), solution.kept.tolist(), strict=True)
    ]


def _to_json(value: dict[str, Any]) -> str:
    import json

    return json.dumps(value, indent=2, allow_nan=False)


def _show(summary: dict[str, Any], passed_over: dict[str, int], written: str) -> None:
    from tools import console

    rows = {
        "graph": f"{summary['vertex_count']} vertices, {summary['edge_count']} edges, {summary['dimension']}-D",
        "closures": f"{summary['closure_count']}: {summary['kept_count']} kept, {summary['rejected_count']} rejected",
        "error": f"{summary['error_before']:.6g} before, {summary['error_after']:.6g} after",
        "converged": f"{'yes' if summary['converged'] else 'no'}, {summary['iterations']} iterations",
    }
    if summary["message"]:
        rows["note"] = summary["message"]
    if passed_over:
        rows["left out"] = ", ".join(f"{count} {tag}" for tag, count in passed_over.items())
    console.show(console.pairs({**rows, "written": written}))
