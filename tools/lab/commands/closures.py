"""dslam benchmark closures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json, SlamLog
from tools.lab.tables import number, percent, show

if TYPE_CHECKING:
    from tools.lab.closures.measurement import ClosureRun


def closures(
    log: SlamLog,
    false_share: Annotated[float, typer.Option(help="Share of all closures, above 0 and below 1.")] = 0.75,
    kind: Annotated[
        str, typer.Option(metavar="random|aliased|shifted|all", help="Kind of the false closures.")
    ] = "all",
    seeds: Annotated[int, typer.Option(min=1, help="Repetitions, each with other closures.")] = 3,
    from_truth: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            min=0.1,
            help="Make the true closures from the truth, one each so many metres; else they are the log's own.",
            show_default=False,
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Put false closures into the graph of a mapped log, and measure what they do to its trajectory.

    random: two places that have nothing to do with each other; aliased: stretches of 20 to 40 m that are taken for
    another, all of one stretch in agreement; shifted: at true revisits, wrong by 5 to 20 m along the street. Each is
    tried beside the true closures and alone. The graph has the keyframes, the odometry and the closures, no landmarks.

    Example: dslam benchmark closures map.mcap --from-truth 10 --false-share 0.75
    """
    from dataclasses import asdict

    from slam.evaluation.inputs.records import read_records
    from tools import console
    from tools.lab.closures.false_closures import KINDS
    from tools.lab.closures.measurement import benchmark_closures, make_drive

    if kind not in (*KINDS, "all"):
        raise typer.BadParameter(f"{kind!r} is none of {', '.join(KINDS)}, all.", param_hint="--kind")
    if not 0.0 < false_share < 1.0:
        raise typer.BadParameter(f"{false_share:g} is not above 0 and below 1.", param_hint="--false-share")
    drive = make_drive(read_records(log))
    kinds = list(KINDS) if kind == "all" else [kind]
    runs = list(benchmark_closures(drive, kinds=kinds, false_share=false_share, seeds=seeds, spacing_m=from_truth))
    if json:
        console.show_json({"log": str(log), "false_share": false_share, "runs": [asdict(run) for run in runs]})
    else:
        show(_rows(runs, false_share))


def _rows(runs: list[ClosureRun], false_share: float) -> list[dict[str, str]]:
    from statistics import median

    cases: dict[tuple[str, bool], list[ClosureRun]] = {}
    for run in runs:
        cases.setdefault((run.case, run.all_false), []).append(run)
    rows = []
    for (case, all_false), group in cases.items():
        share = "" if case in ("odometry", "clean") else ", all" if all_false else f", {100 * false_share:.0f} %"
        rows.append(
            {
                "closures": {"odometry": "none", "clean": "true ones only"}.get(case, f"{case}{share} false"),
                "ATE m": number(median(run.ate_m for run in group), 2),
                "worst": number(max(run.ate_m for run in group), 2),
                "true kept %": percent(_mean(run.true_kept_share for run in group)),
                "false kept %": percent(_mean(run.false_kept_share for run in group)),
                "s": number(median(run.seconds for run in group), 2),
                "converged": f"{sum(run.converged for run in group)} of {len(group)}",
            }
        )
    return rows


def _mean(shares: Iterable[float | None]) -> float | None:
    known = [share for share in shares if share is not None]
    return sum(known) / len(known) if known else None
