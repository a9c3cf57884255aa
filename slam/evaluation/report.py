"""An evaluation as tables for people; whoever prints them chooses the console."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.cells import cell_len
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from slam.evaluation.association import AssociationQuality
from slam.evaluation.closures import NO_TRUE_CANDIDATE, ClosureErrors, ClosureQuality, RevisitQuality
from slam.evaluation.evaluation import Evaluation
from slam.evaluation.landmarks import LandmarkQuality
from slam.evaluation.trajectory import ErrorStatistics, TrajectoryErrors

UNDEFINED = "–"


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
        parts.append(_closure_table(evaluation.closures))
    if evaluation.counters:
        parts.append(_pairs_table("Counters", {name: str(value) for name, value in evaluation.counters.items()}))
    parts += [Text.assemble((f"{part}: ", "bold"), reason) for part, reason in evaluation.missing.items()]
    if with_rules:
        parts.append(_pairs_table("Rules", evaluation.protocol.describe()))
    return parts


def _absolute_table(columns: Sequence[tuple[str, TrajectoryErrors]]) -> Table:
    table = _table("Absolute trajectory error")
    for heading in ("", "RMSE m", "mean m", "median m", "max m", "poses", "without\ntruth", "path m", "aligned by"):
        table.add_column(heading, justify="left" if heading in ("", "aligned by") else "right")
    kinds = {"se3": "SE(3)", "yaw_translation": "yaw + translation"}
    for name, errors in columns:
        a = errors.absolute
        numbers = [f"{value:.3f}" for value in (a.rmse_m, a.mean_m, a.median_m, a.max_m)]
        without = str(errors.outside_count + errors.gap_count)
        table.add_row(
            name, *numbers, str(errors.pose_count), without, f"{errors.length_m:.1f}", kinds[errors.alignment.kind]
        )
    _keep_cells_whole(table)
    return table


def _relative_table(columns: Sequence[tuple[str, TrajectoryErrors]]) -> Table:
    table = _table("Relative error over stretches of path")
    for heading in ("length m", "count", *(f"{name}\n{unit}" for name, _ in columns for unit in ("%", "deg/100 m"))):
        table.add_column(heading, justify="right")
    first = columns[0][1]
    every = [(*errors.short_relative.rows, *errors.relative.rows) for _, errors in columns]
    for index, head in enumerate(every[0]):
        if not any(rows[index].stretch_count for rows in every):
            continue
        cells = []
        for rows in every:
            cells += [_number(rows[index].translation_percent), _number(rows[index].rotation_deg_per_100m)]
        table.add_row(f"{head.length_m:g}", str(head.stretch_count), *cells)
    cells = []
    for _, errors in columns:
        cells += [_number(errors.relative.translation_percent), _number(errors.relative.rotation_deg_per_100m)]
    nominal = [row.length_m for row in first.relative.rows]
    span = f"{min(nominal):g}–{max(nominal):g}" if nominal else UNDEFINED
    table.add_row(span, str(first.relative.stretch_count), *cells, style="bold")
    _keep_cells_whole(table)
    return table


def _association_table(quality: AssociationQuality) -> Table:
    confirmed_false = quality.confirmed_false_landmark_count
    return _pairs_table(
        "Associations of detections with landmarks",
        {
            "right (precision)": _fraction(quality.precision, quality.right_count, quality.assigned_count),
            "right, without false positives": _fraction(
                quality.precision_without_false_positives,
                quality.right_count,
                quality.assigned_count - quality.assigned_false_positive_count,
            ),
            "possible ones made (recall)": _fraction(quality.recall, quality.made_count, quality.possible_count),
            "detections, false positives": f"{quality.detection_count}, {quality.false_positive_count}",
            "landmarks, of false positives": f"{quality.landmark_count}, {quality.false_landmark_count}",
            "confirmed, of false positives": f"{_count(quality.confirmed_landmark_count)}, {_count(confirmed_false)}",
            "landmarks an object: mean, max": f"{_number(quality.mean_landmarks_per_object)}, "
            f"{_count(quality.max_landmarks_per_object)}",
            "confirmed landmarks an object": _number(quality.mean_confirmed_landmarks_per_object),
            "frames, without truth, without associations": f"{quality.frame_count}, {quality.frames_without_truth}, "
            f"{quality.frames_without_associations}",
        },
    )


def _landmark_table(quality: LandmarkQuality) -> Table:
    return _pairs_table(
        "Landmarks of the final map",
        {
            "confirmed, matched with an object": f"{quality.confirmed_count}, {quality.matched_count} "
            f"(by {quality.method})",
            "error, aligned by windows": _error(quality.windowed),
            "the same, in the plane": _error(quality.windowed_horizontal),
            "windows, skipped, landmarks in them": f"{quality.window_count}, {quality.skipped_window_count}, "
            f"{quality.windowed_landmark_count}",
            "error, global frame": _error(quality.global_frame),
            "class right": _fraction(quality.class_accuracy, quality.class_right_count, quality.matched_count),
            "precision": _fraction(quality.precision, quality.object_landmark_count, quality.confirmed_count),
            "recall": _fraction(quality.recall, quality.recalled_object_count, quality.recallable_object_count),
        },
    )


def _closure_table(quality: ClosureQuality) -> Table:
    rows = {
        "candidates, accepted, in the graph": f"{quality.candidate_count}, {quality.accepted_count}, "
        f"{quality.inserted_count}",
        "verdict by stage": _counts(quality.stage_counts),
    }
    if quality.true_count is not None and quality.false_count is not None:
        precision = _fraction(quality.precision, quality.true_count, quality.true_count + quality.false_count)
        rows["precision"] = precision + (f", {quality.undecided_count} undecided" if quality.undecided_count else "")
    if quality.revisits is not None:
        rows["recall"] = _recall(quality.revisits)
        rows["missed revisits by stage"] = _missed(quality.revisits)
    if quality.errors is not None:
        rows["error of the true ones"] = _closure_error(quality.errors)
    if quality.revisits is not None and quality.revisits.sweep is not None and quality.candidate_count:
        sweep = quality.revisits.sweep
        rows["by a threshold on the score"] = (
            f"average precision {sweep.average_precision:.3f}, largest F1 {sweep.f1_max:.3f}, "
            f"recall at full precision {sweep.recall_at_full_precision:.3f}"
        )
    return _pairs_table("Loop closures", rows)


def _recall(revisits: RevisitQuality) -> str:
    if not revisits.revisit_count:
        return f"{UNDEFINED} (no revisit)"
    directions = ", ".join(
        f"{name} {UNDEFINED}"
        if (recall := revisits.recall_of(name)) is None
        else f"{name} {100.0 * recall:.2f} % of {count}"
        for name, count in revisits.revisit_counts.items()
    )
    share = f"{100.0 * revisits.recalled_count / revisits.revisit_count:.2f} %"
    return f"{share} ({revisits.recalled_count} of {revisits.revisit_count} revisits; {directions})"


def _missed(revisits: RevisitQuality) -> str:
    texts = []
    for stage, count in revisits.missed_by_stage.items():
        detail = (
            f" ({revisits.missed_without_candidate_count} without any candidate, {revisits.missed_at_place_count} with "
            "the right place)"
        )
        texts.append(f"{stage} {count}{detail if stage == NO_TRUE_CANDIDATE else ''}")
    return ", ".join(texts) or "none"


def _closure_error(errors: ClosureErrors) -> str:
    spread = errors.within_revisit_spread_m
    return (
        f"median {errors.median_translation_m:.3f} m, {errors.median_rotation_deg:.3f} deg; "
        f"in the plane {errors.median_planar_m:.3f} m, {errors.median_heading_deg:.3f} deg; "
        f"95 % {errors.p95_translation_m:.3f} m, {errors.p95_rotation_deg:.3f} deg; "
        f"spread within a revisit {UNDEFINED if spread is None else f'{spread:.3f} m'}"
    )


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or "none"


def _pairs_table(title: str, rows: dict[str, str]) -> Table:
    table = _table(title, show_header=False)
    table.add_column(style="cyan")
    table.add_column(min_width=max((cell_len(word) for value in rows.values() for word in value.split()), default=1))
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _keep_cells_whole(table: Table) -> None:
    """A number that loses digits is another number: no column is narrower than its cells, only headings are folded."""
    for column in table.columns:
        column.overflow = "fold"
        column.min_width = max((cell_len(str(cell)) for cell in column.cells), default=1)


def _table(title: str, *, show_header: bool = True) -> Table:
    """Without lines, so that it fits 80 columns and can be pasted anywhere."""
    return Table(
        title=f"\n{title}",
        title_justify="left",
        title_style="bold",
        header_style="cyan",
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
        show_header=show_header,
    )


def _error(statistics: ErrorStatistics | None) -> str:
    if statistics is None:
        return UNDEFINED
    return f"median {statistics.median_m:.3f} m, 95 % {statistics.p95_m:.3f} m, max {statistics.max_m:.3f} m"


def _fraction(value: float | None, part: int | None, whole: int | None) -> str:
    return UNDEFINED if value is None else f"{100.0 * value:.2f} % ({part} of {whole})"


def _number(value: float | None) -> str:
    return UNDEFINED if value is None else f"{value:.3f}"


def _count(value: int | None) -> str:
    return UNDEFINED if value is None else str(value)
