"""An evaluation as tables for people; the caller chooses the console."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from slam.evaluation.metrics.association import AssociationQuality
from slam.evaluation.metrics.calibration import CalibrationQuality
from slam.evaluation.metrics.landmarks import LandmarkQuality
from slam.evaluation.metrics.trajectory import TrajectoryErrors
from slam.evaluation.report.text_closures import closure_table, literature_table, relocalization_table
from slam.evaluation.report.text_tables import (
    UNDEFINED,
    count,
    error,
    fraction,
    keep_cells_whole,
    number,
    pairs_table,
    plain_table,
)
from slam.evaluation.result import Evaluation


def render(evaluation: Evaluation, *, with_rules: bool = True) -> list[RenderableType]:
    """Tables of an evaluation, top to bottom; a part that is missing is one line with its reason.

    Args:
        evaluation: what was measured.
        with_rules: add the rules and thresholds under the numbers.
    """
    parts: list[RenderableType] = []
    columns = [
        (name, errors)
        for name, errors in (
            ("estimate", evaluation.estimate),
            ("odometry", evaluation.odometry),
            ("online", evaluation.online),
            ("estimate by\nclosure reference", evaluation.by_closure_reference),
        )
        if errors is not None
    ]
    if columns:
        parts += [_absolute_table(columns), _relative_table(columns)]
        parts += [Text(f"{name}: {errors.alignment.note}") for name, errors in columns if errors.alignment.note]
    if evaluation.associations is not None:
        parts.append(_association_table(evaluation.associations))
    if evaluation.landmarks is not None:
        parts.append(_landmark_table(evaluation.landmarks))
    if evaluation.closures is not None:
        parts.append(closure_table(evaluation.closures, evaluation.retrieval))
    if evaluation.pairs is not None and evaluation.online_queries is not None:
        parts.append(literature_table(evaluation.pairs, evaluation.online_queries))
    if evaluation.relocalization is not None and evaluation.relocalization.loss_count:
        parts.append(relocalization_table(evaluation.relocalization))
    if evaluation.calibration is not None:
        parts.append(_calibration_table(evaluation.calibration))
    if evaluation.counters:
        parts.append(pairs_table("Counters", {name: str(value) for name, value in evaluation.counters.items()}))
    parts += _unavailable_lines(evaluation.unavailable)
    if with_rules:
        parts.append(pairs_table("Rules", evaluation.protocol.describe()))
    return parts


def _unavailable_lines(missing: Mapping[str, str]) -> list[Text]:
    """A line for each reason, with the parts that it keeps from being measured."""
    parts_of: dict[str, list[str]] = {}
    for part, reason in missing.items():
        parts_of.setdefault(reason, []).append(part)
    return [Text.assemble((f"{', '.join(parts)}: ", "bold"), reason) for reason, parts in parts_of.items()]


def _absolute_table(columns: Sequence[tuple[str, TrajectoryErrors]]) -> Table:
    table = plain_table("Absolute trajectory error, aligned by SE(3)")
    headings = ("RMSE m", "mean m", "median m", "max m", "poses", "without\ntruth", "path m", "by yaw,\nRMSE m")
    for heading in ("", *headings):
        table.add_column(heading, justify="right" if heading else "left")
    for name, errors in columns:
        a = errors.absolute
        numbers = [f"{value:.3f}" for value in (a.rmse_m, a.mean_m, a.median_m, a.max_m)]
        without = str(errors.outside_count + errors.gap_count)
        yaw = number(errors.absolute_yaw.rmse_m if errors.absolute_yaw else None)
        table.add_row(name, *numbers, str(errors.pose_count), without, f"{errors.length_m:.1f}", yaw)
    keep_cells_whole(table)
    return table


def _relative_table(columns: Sequence[tuple[str, TrajectoryErrors]]) -> Table:
    table = plain_table("Relative error over stretches of path")
    for heading in ("length m", "count", *(f"{name}\n{unit}" for name, _ in columns for unit in ("%", "deg/100 m"))):
        table.add_column(heading, justify="right")
    first = columns[0][1]
    every = [(*errors.short_relative.rows, *errors.relative.rows) for _, errors in columns]
    for index, head in enumerate(every[0]):
        if not any(rows[index].stretch_count for rows in every):
            continue
        cells = []
        for rows in every:
            cells += [number(rows[index].translation_percent), number(rows[index].rotation_deg_per_100m)]
        table.add_row(f"{head.length_m:g}", str(head.stretch_count), *cells)
    cells = []
    for _, errors in columns:
        cells += [number(errors.relative.translation_percent), number(errors.relative.rotation_deg_per_100m)]
    nominal = [row.length_m for row in first.relative.rows]
    span = f"{min(nominal):g}–{max(nominal):g}" if nominal else UNDEFINED
    table.add_row(span, str(first.relative.stretch_count), *cells, style="bold")
    keep_cells_whole(table)
    return table


def _association_table(quality: AssociationQuality) -> Table:
    confirmed_false = quality.confirmed_false_landmark_count
    return pairs_table(
        "Associations of detections with landmarks",
        {
            "right (precision)": fraction(quality.precision, quality.right_count, quality.assigned_count),
            "right, without false positives": fraction(
                quality.precision_without_false_positives,
                quality.right_count,
                quality.assigned_count - quality.assigned_false_positive_count,
            ),
            "possible ones made (recall)": fraction(quality.recall, quality.made_count, quality.possible_count),
            "detections, false positives": f"{quality.detection_count}, {quality.false_positive_count}",
            "landmarks, of false positives": f"{quality.landmark_count}, {quality.false_landmark_count}",
            "confirmed, of false positives": f"{count(quality.confirmed_landmark_count)}, {count(confirmed_false)}",
            "landmarks an object: mean, max": f"{number(quality.mean_landmarks_per_object)}, "
            f"{count(quality.max_landmarks_per_object)}",
            "confirmed landmarks an object": number(quality.mean_confirmed_landmarks_per_object),
            "frames, without truth, without associations": f"{quality.frame_count}, {quality.frames_without_truth}, "
            f"{quality.frames_without_associations}",
        },
    )


def _landmark_table(quality: LandmarkQuality) -> Table:
    return pairs_table(
        "Landmarks of the final map",
        {
            "confirmed, matched with an object": f"{quality.confirmed_count}, {quality.matched_count} "
            f"(by {quality.method})",
            "error, aligned by windows": error(quality.windowed),
            "the same, in the plane": error(quality.windowed_horizontal),
            "windows, skipped, landmarks in them": f"{quality.window_count}, {quality.skipped_window_count}, "
            f"{quality.windowed_landmark_count}",
            "error, global frame": error(quality.global_frame),
            "class right": fraction(quality.class_accuracy, quality.class_right_count, quality.matched_count),
            "precision": fraction(quality.precision, quality.object_landmark_count, quality.confirmed_count),
            "recall": fraction(quality.recall, quality.recalled_object_count, quality.recallable_object_count),
        },
    )


def _calibration_table(quality: CalibrationQuality) -> Table:
    table = plain_table("Errors by their covariances (NEES: 1 is right, more is overconfident)")
    inside = f"within the\n{100.0 * quality.probability:g} % region %"
    for heading in ("", "errors", "NEES", inside, "NEES,\nin the plane", f"{inside},\nin the plane"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, parts in (
        ("keyframes", (quality.pose, quality.planar_pose)),
        ("landmarks", (quality.landmark, quality.planar_landmark)),
        ("closures", (quality.closure, quality.planar_closure)),
    ):
        cells = [str(parts[0].count if parts[0] else 0)]
        for part in parts:
            share = f"{100.0 * part.coverage(quality.probability):.1f}" if part else UNDEFINED
            cells += [number(part.nees if part else None), share]
        table.add_row(name, *cells)
    keep_cells_whole(table)
    return table
