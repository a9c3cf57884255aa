"""dslam evaluate."""

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, Picture, SlamLog, Topics, check_outputs, parse_topics
from tools.evaluation.requirements import Require, finish


def evaluate(
    log: SlamLog,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG|POSES", help="Ground truth: a log, or poses of the body (TUM, KITTI or CSV, also .gz)."
        ),
    ] = None,
    calib: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="KITTI's calib.txt, if references in its format are of the left camera."),
    ] = None,
    topics: Topics = None,
    as_json: Json = False,
    picture: Picture = None,
    map_run: Annotated[
        Path | None, typer.Option(metavar="OUT.mcap", help="The drive that made the map of this relocalization.")
    ] = None,
    require: Require = None,
) -> None:
    """Compare a map with the truth: trajectory, associations, landmarks, loop closures.

    Example: dslam evaluate map.mcap --require "trajectory.ate_m<=4.0" --picture map.png
    """
    chosen = parse_topics(topics)
    check_outputs([picture], [log, reference, calib, map_run])
    from slam.common.errors import EvaluationError
    from slam.evaluation.evaluate import evaluate
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.metrics.trajectory import evaluate_trajectory
    from slam.evaluation.report.figures import summarize
    from tools import console

    records = read_records(log, reference=reference, calib=calib, topics=chosen)
    if not (records.final_path or records.online_path):
        raise EvaluationError(f"{log} holds no estimate (no topics under /slam); give a log that 'dslam replay' wrote")
    T_world_map = None
    if map_run is not None:
        mapping = read_records(map_run)
        try:
            T_world_map = evaluate_trajectory(mapping.final_path, mapping.true_path).T_world_map
        except EvaluationError as error:
            raise EvaluationError(f"--map-run {map_run}: {error}") from error
    evaluation = evaluate(records, map_alignment=T_world_map)
    if picture is not None:
        from slam.evaluation.report.picture import compose_picture

        compose_picture(records, evaluation, log.stem).save(picture)
    results = evaluation.to_json_dict()
    if as_json:
        console.show_json(results)
    else:
        console.show(console.pairs(summarize(results) | ({} if picture is None else {"written": str(picture)})))
    finish({"": results}, require, quiet=as_json)
