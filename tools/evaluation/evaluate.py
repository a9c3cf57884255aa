"""dslam evaluate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json, Picture, SlamLog, Topics, can_draw, check_outputs, parse_topics
from tools.evaluation.evaluated_log import Truth, evaluate_log
from tools.evaluation.output import (
    Calib,
    Findings,
    JsonFile,
    MapRun,
    Protocols,
    Reference,
    Require,
    Rules,
    Times,
    parse_thresholds,
    report,
)

if TYPE_CHECKING:
    from rich.console import RenderableType


def evaluate(
    log: SlamLog,
    reference: Reference = None,
    times: Times = None,
    calib: Calib = None,
    topics: Topics = None,
    as_json: Json = False,
    json_file: JsonFile = None,
    picture: Picture = None,
    page: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE.html", help="Write a self-contained page with charts.", callback=can_draw),
    ] = None,
    map_run: MapRun = None,
    protocol: Protocols = None,
    require: Require = None,
    every: Annotated[
        bool, typer.Option("--all", help="Print all figures, not only the six lines of the summary.")
    ] = False,
    rules: Rules = False,
) -> None:
    """Compare a map with the truth: trajectory, associations, landmarks, loop closures.

    Example: dslam evaluate map.mcap --require "trajectory.ate_m<=4.0" --picture map.png
    """
    chosen = parse_topics(topics)
    check_outputs([json_file, picture, page], [log, reference, times, calib, map_run])
    from slam.evaluation.requirements import parse_requirement

    requirements = [parse_requirement(text) for text in require or ()]
    truth = Truth(reference, times, calib, chosen, map_run, parse_thresholds(protocol))
    findings = _evaluate_log(log, truth, picture, page, json_file, every=every)
    report(findings, requirements, as_json=as_json, with_rules=rules, json_file=json_file)


def _evaluate_log(
    log: Path, truth: Truth, picture: Path | None, page: Path | None, json_file: Path | None, *, every: bool
) -> Findings:
    from slam.evaluation.report.figures import list_figures, summarize
    from tools import console

    records, evaluation = evaluate_log(log, truth)
    if picture is not None:
        from slam.display.map_picture import draw_map
        from slam.evaluation.report.picture import compose_picture

        draw_map(picture, compose_picture(records, evaluation, title=log.stem))
    if page is not None:
        from slam.evaluation.page.page import write_page

        write_page(page, records, evaluation, title=log.stem)
    results = evaluation.to_json_dict()
    written = ", ".join(str(path) for path in (picture, page, json_file) if path is not None)
    parts: list[RenderableType] = [console.pairs(summarize(results) | ({"written": written} if written else {}))]
    if every:
        listed = list_figures(results) | {"not measured": dict(evaluation.unavailable)}
        parts += [console.pairs(texts, title=f"\n{title}") for title, texts in listed.items()]
    return Findings(results, parts, {"": results}, rules=evaluation.protocol.describe())
