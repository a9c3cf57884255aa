"""dslam evaluate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json, Picture, SlamLog, Topics, check_outputs, parse_topics
from tools.evaluation.requirements import Require, finish

if TYPE_CHECKING:
    from slam.common.arrays import FloatArray

Reference = Annotated[
    Path | None,
    typer.Option(
        metavar="LOG|POSES",
        help="Ground truth: a log, or poses of the body (TUM, KITTI or CSV, also .gz).",
    ),
]
Times = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Seconds of each pose in KITTI's format; not needed with one pose per odometry message.",
    ),
]
Calib = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="KITTI's calib.txt, if references in its format are of the left camera.",
    ),
]
MapRun = Annotated[
    Path | None,
    typer.Option(metavar="OUT.mcap", help="The drive that made the map of this relocalization."),
]
Protocols = Annotated[
    list[str] | None,
    typer.Option(
        "--protocol",
        metavar="NAME=NUMBER",
        help="A threshold of the evaluation, under protocol in --json, e.g. closure_translation_m=4. Repeatable.",
    ),
]


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
    chosen, thresholds = parse_topics(topics), _parse_thresholds(protocol or ())
    check_outputs([picture], [log, reference, times, calib, map_run])
    from logs.storage.opening import is_log
    from slam.common.errors import EvaluationError
    from slam.evaluation.evaluate import evaluate, protocol_of
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.inputs.text_reference import TextReference
    from slam.evaluation.report.figures import list_figures, summarize
    from tools import console

    truth = reference if reference is None or is_log(reference) else TextReference(reference, times, calib)
    records = read_records(log, reference=truth, topics=chosen)
    map_alignment = None if map_run is None else _locate_map_of(map_run)
    if records.trajectory is None and not records.online_poses:
        raise EvaluationError(f"{log} holds no estimate (no topics under /slam); give a log that 'dslam replay' wrote")
    evaluation = evaluate(records, protocol_of(records).with_thresholds(thresholds), map_alignment=map_alignment)
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


def _parse_thresholds(texts: Sequence[str]) -> dict[str, float]:
    """Thresholds by name, of texts like "closure_translation_m=4".

    Raises:
        EvaluationError: one of another form.
    """
    from slam.common.errors import EvaluationError

    thresholds: dict[str, float] = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            thresholds[name.strip()] = float(number)
        except ValueError:
            raise EvaluationError(f"--protocol {text}: give NAME=NUMBER, e.g. closure_translation_m=4") from None
    return thresholds


def _locate_map_of(log: Path) -> FloatArray:
    """``T_world_map`` (4, 4) of the map that the drive in ``log`` made.

    Raises:
        LogError: it cannot be read.
        EvaluationError: it has no trajectory or no truth.
    """
    from slam.common.errors import EvaluationError
    from slam.evaluation.inputs.protocol import Protocol
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.metrics.trajectory import evaluate_trajectory

    mapping, max_gap_s = read_records(log), Protocol().max_truth_gap_s
    try:
        return evaluate_trajectory(mapping.final_path, mapping.true_path, max_gap_s=max_gap_s).alignment.T_world_map
    except EvaluationError as error:
        raise EvaluationError(f"--map-run {log}: {error}") from error
