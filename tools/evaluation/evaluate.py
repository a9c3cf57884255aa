"""dslam evaluate."""

from __future__ import annotations

from typing import Annotated

import typer

from tools.arguments import Json, Picture, SlamLog, Topics, check_outputs, parse_topics
from tools.evaluation.evaluated_log import (
    Calib,
    MapRun,
    Protocols,
    Reference,
    Times,
    evaluate_log,
    parse_thresholds,
)
from tools.evaluation.requirements import Require, finish


def evaluate(
    log: SlamLog,
    reference: Reference = None,
    times: Times = None,
    calib: Calib = None,
    topics: Topics = None,
    as_json: Json = False,
    picture: Picture = None,
    map_run: MapRun = None,
    protocol: Protocols = None,
    require: Require = None,
    every: Annotated[
        bool, typer.Option("--all", help="Print all figures, not only the six lines of the summary.")
    ] = False,
) -> None:
    """Compare a map with the truth: trajectory, associations, landmarks, loop closures.

    Example: dslam evaluate map.mcap --require "trajectory.ate_m<=4.0" --picture map.png
    """
    truth = (reference, times, calib, map_run, parse_topics(topics), parse_thresholds(protocol))
    check_outputs([picture], [log, reference, times, calib, map_run])
    from slam.evaluation.report.figures import list_figures, summarize
    from tools import console

    records, evaluation = evaluate_log(log, *truth)
    if picture is not None:
        from slam.display.map_picture import draw_map
        from slam.evaluation.report.picture import compose_picture

        draw_map(picture, compose_picture(records, evaluation, title=log.stem))
    results = evaluation.to_json_dict()
    if as_json:
        console.show_json(results)
    else:
        console.show(console.pairs(summarize(results) | ({} if picture is None else {"written": str(picture)})))
        if every:
            listed = list_figures(results) | {"not measured": dict(evaluation.unavailable)}
            console.show(*(console.pairs(texts, title=f"\n{title}") for title, texts in listed.items()))
    finish({"": results}, require, quiet=as_json)
