"""dslam evaluate."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, Picture, SlamLog, Topics, check_outputs, parse_topics

FELL_SHORT = 1


def expand_json_file(arguments: Sequence[str]) -> list[str]:
    """``--json FILE.json`` as ``--json-file FILE.json``: a value that an option may but need not have."""
    expanded: list[str] = []
    for argument in arguments:
        if expanded and expanded[0] == "evaluate" and expanded[-1] == "--json" and argument.endswith(".json"):
            expanded[-1] = "--json-file"
        expanded.append(argument)
    return expanded


def evaluate(
    log: SlamLog,
    reference: Annotated[
        Path | None, typer.Option(metavar="LOG.mcap", help="Take the truth from this log.", show_default=False)
    ] = None,
    topics: Topics = None,
    as_json: Json = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json-file", metavar="FILE", help="Write the JSON object to a file; also --json FILE.json."),
    ] = None,
    picture: Picture = None,
    require: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY<=NUMBER", help="Exit with 1 unless it holds (<= >= == < >). Repeatable."),
    ] = None,
    rules: Annotated[bool, typer.Option("--rules", help="Also print by which rules everything is measured.")] = False,
) -> None:
    """Compare a map with the truth: trajectory, associations, landmarks.

    Example: dslam evaluate map.mcap --require "trajectory.ate_m<=4.0" --picture map.png
    """
    chosen = parse_topics(topics)
    check_outputs([json_file, picture], [log, reference])
    from logs.errors import UnwritableLogError
    from slam.errors import EvaluationError
    from slam.evaluation.gather import evaluate as evaluate_records
    from slam.evaluation.records import read_records
    from slam.evaluation.report import render
    from slam.evaluation.requirements import parse_requirement
    from tools import console

    requirements = [parse_requirement(text) for text in require or ()]
    records = read_records(log, reference=reference, topics=chosen)
    if records.trajectory is None and not records.online_poses:
        raise EvaluationError(f"{log} holds no estimate (no topics under /slam); give a log that 'dslam replay' wrote")
    evaluation = evaluate_records(records)
    results = evaluation.to_json_dict()
    if as_json:
        console.show_json(results)
    else:
        console.show(*render(evaluation, with_rules=rules))
    if json_file is not None:
        try:
            json_file.write_text(json.dumps(results, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise UnwritableLogError(f"cannot write {json_file}: {error.strerror}") from error
    if picture is not None:
        from slam.evaluation.picture import compose_picture
        from slam.pictures import draw_map

        draw_map(picture, compose_picture(records, evaluation, title=log.stem))
    shortfalls = [text for requirement in requirements if (text := requirement.shortfall(results))]
    if shortfalls:
        sys.stdout.flush()
        print(f"dslam: fell short: {'; '.join(shortfalls)}", file=sys.stderr)
        raise typer.Exit(FELL_SHORT)
