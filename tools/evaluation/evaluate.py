"""dslam evaluate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, Picture, Topics, check_outputs, parse_topics
from tools.evaluation.evaluated_log import Truth, evaluate_log, locate_map_of
from tools.evaluation.output import Findings, tell

_SWEEP = "A sweep over degradations"


def expand_json_file(arguments: Sequence[str]) -> list[str]:
    """``--json FILE.json`` as ``--json-file FILE.json``: a value that an option may but need not have."""
    expanded: list[str] = []
    for argument in arguments:
        if expanded and expanded[0] == "evaluate" and expanded[-1] == "--json" and argument.endswith(".json"):
            expanded[-1] = "--json-file"
        expanded.append(argument)
    return expanded


def evaluate(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="OUT.mcap",
            help="Logs that 'dslam replay' wrote; several are compared. With --sweep a drive.",
            show_default=False,
        ),
    ],
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
    page: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE.html", help="Write a page to look at, which needs nothing beside it."),
    ] = None,
    map_run: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.mcap", help="The drive that made the map in which this one relocalized.", show_default=False
        ),
    ] = None,
    require: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY<=NUMBER", help="Exit with 1 unless it holds (<= >= == < >), of every run. Repeatable."
        ),
    ] = None,
    rules: Annotated[bool, typer.Option("--rules", help="Also print by which rules everything is measured.")] = False,
    sweep: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Degrade, map and evaluate the drive again and again; DIR keeps what is finished.",
            rich_help_panel=_SWEEP,
            show_default=False,
        ),
    ] = None,
    degrade: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE,...",
            help="Options of 'dslam degrade' that belong together. Repeatable; without it five usual ones.",
            rich_help_panel=_SWEEP,
        ),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Seeds of each degradation. \\[default: 3]", rich_help_panel=_SWEEP)
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes. \\[default: one a core]", rich_help_panel=_SWEEP)
    ] = None,
    config_file: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE.toml", help="Settings of the replays.", rich_help_panel=_SWEEP),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="One setting; wins over the file. Repeatable.", rich_help_panel=_SWEEP
        ),
    ] = None,
) -> None:
    """Compare a map with the truth: trajectory, associations, landmarks, loop closures.

    Several logs are set side by side; those of one configuration are taken as
    its repetitions, and differences that exceed their spread are marked. With
    --sweep, a drive is degraded, mapped and evaluated for each --degrade and
    seed; if it is killed, the same command goes on where it was.

    Example: dslam evaluate map.mcap --require "trajectory.ate_m<=4.0" --picture map.png

    Example: dslam evaluate drive.mcap --sweep out/sweep --degrade dropout=0.5 --degrade dropout=0.8,max_range=30
    """
    chosen = parse_topics(topics)
    one_log = {"--picture": picture, "--html": page}
    if sweep is not None:
        _refuse({"--reference": reference, "--map-run": map_run, **one_log}, "does not go with --sweep")
        if len(logs) > 1:
            raise typer.BadParameter(f"{len(logs)} logs were given; a sweep is over one drive", param_hint="--sweep")
    else:
        only_sweep = {"--degrade": degrade, "--seeds": seeds, "--jobs": jobs, "--config": config_file}
        _refuse({**only_sweep, "--set": settings}, "needs --sweep DIR")
    if len(logs) > 1:
        _refuse(one_log, "is of one run; give one log")
    check_outputs([json_file, picture, page], [*logs, reference, map_run])
    from slam.evaluation.requirements import parse_requirement

    requirements = [parse_requirement(text) for text in require or ()]
    if sweep is not None:
        from tools.evaluation.sweep import sweep_drive

        findings = sweep_drive(
            logs[0],
            sweep,
            degradations=degrade or (),
            seeds=seeds,
            jobs=jobs,
            config_file=config_file,
            settings=settings or (),
            topics=chosen,
        )
    else:
        truth = Truth(reference, chosen, None if map_run is None else locate_map_of(map_run))
        if len(logs) > 1:
            from tools.evaluation.comparison import compare_logs

            findings = compare_logs(logs, truth)
        else:
            findings = _evaluate_log(logs[0], truth, picture, page)
    tell(findings, requirements, as_json=as_json, with_rules=rules, json_file=json_file)


def _evaluate_log(log: Path, truth: Truth, picture: Path | None, page: Path | None) -> Findings:
    from slam.evaluation.report.text import render

    records, evaluation = evaluate_log(log, truth)
    if picture is not None:
        from slam.evaluation.report.picture import compose_picture
        from slam.visualization.map_plot import draw_map

        draw_map(picture, compose_picture(records, evaluation, title=log.stem))
    if page is not None:
        from slam.evaluation.html_report import write_report

        write_report(page, records, evaluation, title=log.stem)
    results = evaluation.to_json_dict()
    return Findings(results, render(evaluation, with_rules=False), {"": results})


def _refuse(options: Mapping[str, object], why: str) -> None:
    for option, value in options.items():
        if value:
            raise typer.BadParameter(f"{option} {why}", param_hint=option)
