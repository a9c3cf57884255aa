"""One log of a replay, read and evaluated, and the options that say how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from slam.common.arrays import FloatArray
    from slam.evaluation.inputs.records import EvaluationRecords
    from slam.evaluation.result import Evaluation

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


def parse_thresholds(texts: Sequence[str] | None) -> dict[str, float]:
    """Thresholds by name, of texts like "closure_translation_m=4".

    Raises:
        EvaluationError: one of another form.
    """
    from slam.common.errors import EvaluationError

    thresholds: dict[str, float] = {}
    for text in texts or ():
        name, _, number = text.partition("=")
        try:
            thresholds[name.strip()] = float(number)
        except ValueError:
            raise EvaluationError(f"--protocol {text}: give NAME=NUMBER, e.g. closure_translation_m=4") from None
    return thresholds


def evaluate_log(
    log: Path,
    reference: Path | None,
    times: Path | None,
    calib: Path | None,
    map_run: Path | None,
    topics: Mapping[str, str],
    thresholds: Mapping[str, float],
) -> tuple[EvaluationRecords, Evaluation]:
    """The records of the log and their evaluation.

    Args:
        log: of a replay.
        reference: the log, or the file of poses, that holds the truth; None if ``log`` does.
        times: seconds of each pose in KITTI's format.
        calib: of the camera of such poses.
        map_run: the drive that made the map in which the robot found itself.
        topics: of the truth, by kind.
        thresholds: of the protocol, by name, that are not its own.

    Raises:
        LogError: it cannot be read.
        EvaluationError: it holds no estimate.
    """
    from logs.storage.opening import is_log
    from slam.common.errors import EvaluationError
    from slam.evaluation.evaluate import evaluate, protocol_of
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.inputs.text_reference import TextReference

    truth = reference if reference is None or is_log(reference) else TextReference(reference, times, calib)
    records = read_records(log, reference=truth, topics=topics)
    map_alignment = None if map_run is None else _locate_map_of(map_run)
    if records.trajectory is None and not records.online_poses:
        raise EvaluationError(f"{log} holds no estimate (no topics under /slam); give a log that 'dslam replay' wrote")
    protocol = protocol_of(records).with_thresholds(thresholds)
    return records, evaluate(records, protocol, map_alignment=map_alignment)


@cache
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
