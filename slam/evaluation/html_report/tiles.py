"""The first screen: five lines on the run, and the few figures that matter."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from slam.common.config import Config
from slam.common.config_tree import changes
from slam.common.geometry import travelled_m
from slam.evaluation.html_report.markup import UNDEFINED, escape, format_metres, format_percent
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.metrics.landmarks import CONFIRMED
from slam.evaluation.result import Evaluation


@dataclass(frozen=True, slots=True)
class Tile:
    """One figure: what it is, its value, and what stands behind it."""

    label: str
    value: str
    note: str


def describe_run(records: EvaluationRecords, evaluation: Evaluation) -> dict[str, str]:
    """What ran, its version, the settings that differ, its speed and the result: a line each."""
    return {
        "Run": _run(records, evaluation),
        "Version": f"dslam {records.provenance.get('version', 'unknown')}",
        "Settings": _settings(records),
        "Speed": "not in the log, which is the same on every machine; dslam replay prints it",
        "Result": _result(records, evaluation),
    }


def _run(records: EvaluationRecords, evaluation: Evaluation) -> str:
    errors = evaluation.estimate or evaluation.online or evaluation.odometry
    parts = []
    length_m, duration_s = (errors.length_m, errors.duration_s) if errors is not None else _extent(records)
    if duration_s > 0.0:
        minutes, seconds = divmod(round(duration_s), 60)
        parts.append(f"{length_m:.0f} m in {minutes} min {seconds} s")
    if "keyframes" in evaluation.counters:
        parts.append(f"{evaluation.counters['keyframes']} keyframes")
    if records.has_prior_map:
        parts.append("localized in the saved map of an earlier drive")
    if digest := records.provenance.get("input_sha256"):
        parts.append(f"input sha256 {digest[:12]}")
    return ", ".join(parts) or "the log holds no trajectory"


def _extent(records: EvaluationRecords) -> tuple[float, float]:
    """Length [m] and duration [s] of the trajectory where no truth tells them."""
    trajectory = records.trajectory
    if trajectory is None or len(trajectory.stamps_ns) == 0:
        return 0.0, 0.0
    return float(travelled_m(trajectory.T_map_body)[-1]), float(np.ptp(trajectory.stamps_ns)) * 1e-9


def _settings(records: EvaluationRecords) -> str:
    if not records.configuration:
        return "unknown: the log does not hold them"
    changed = changes(Config(), json.dumps(records.configuration))
    text = f"defaults, but {', '.join(changed)}" if changed else "defaults"
    estimated = records.provenance.get("estimated", "")
    return text + ("; noise and lengths estimated from the log" if estimated not in ("", "{}") else "")


def _result(records: EvaluationRecords, evaluation: Evaluation) -> str:
    parts = []
    if evaluation.estimate is not None:
        alone = evaluation.odometry
        before = f" (odometry alone {format_metres(alone.absolute.rmse_m)})" if alone else ""
        parts.append(f"{format_metres(evaluation.estimate.absolute.rmse_m)} from the truth{before}")
    quality = evaluation.closures
    if quality is not None and quality.false_count is not None:
        wrong = "none false" if quality.false_count == 0 else f"{quality.false_count} FALSE"
        if quality.accepted_count and quality.accepted_count == quality.undecided_count:
            wrong = "not compared with the truth"
        parts.append(f"{quality.accepted_count} closures, {wrong}")
        if quality.revisits is not None and quality.revisits.revisit_count:
            parts.append(f"{quality.revisits.recalled_count} of {quality.revisits.revisit_count} revisits closed")
    lost = evaluation.relocalization
    if lost is not None and lost.loss_count:
        parts.append(f"lost {lost.loss_count}, found {lost.fix_count}, wrong {lost.wrong_count}")
    if records.status is not None and records.status.level != "info":
        parts.append(f"{records.status.level}: {records.status.message}")
    return "; ".join(parts) or "nothing to compare with: the log holds no truth"


def render_run(lines: dict[str, str]) -> str:
    """A description list."""
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>\n" for name, text in lines.items())
    return f'<dl class="run">\n{items}</dl>\n'


def compose_tiles(records: EvaluationRecords, evaluation: Evaluation) -> list[Tile]:
    """One tile each for trajectory, odometry, closures, landmarks and relocalization, where they are measured."""
    tiles = [
        _trajectory(evaluation),
        _odometry(evaluation),
        _precision(evaluation),
        _recall(evaluation),
        _landmarks(records, evaluation),
        _relocalization(evaluation),
    ]
    return [tile for tile in tiles if tile.value != UNDEFINED]


def render_tiles(tiles: list[Tile]) -> str:
    """A description list."""
    items = "".join(
        f'<div class="tile"><dt>{escape(tile.label)}</dt><dd class="value">{escape(tile.value)}</dd>'
        f'<dd class="note">{escape(tile.note)}</dd></div>\n'
        for tile in tiles
    )
    return f'<dl class="tiles">\n{items}</dl>\n'


def _trajectory(evaluation: Evaluation) -> Tile:
    errors = evaluation.estimate or evaluation.online
    label = "Trajectory error (ATE)"
    if errors is None:
        return Tile(label, UNDEFINED, evaluation.unavailable.get("trajectory", ""))
    stand_in = "" if evaluation.estimate else "poses as they were at their time; "
    return Tile(
        label,
        format_metres(errors.absolute.rmse_m),
        f"{stand_in}RMSE over {format_metres(errors.length_m)}, at most {format_metres(errors.absolute.max_m)}",
    )


def _odometry(evaluation: Evaluation) -> Tile:
    label = "Odometry alone (ATE)"
    if evaluation.odometry is None:
        return Tile(label, UNDEFINED, evaluation.unavailable.get("odometry", ""))
    before = evaluation.odometry.absolute
    return Tile(label, format_metres(before.rmse_m), f"at most {format_metres(before.max_m)}")


def _precision(evaluation: Evaluation) -> Tile:
    quality, label = evaluation.closures, "Closure precision"
    if quality is None:
        return Tile(label, UNDEFINED, evaluation.unavailable.get("closures", ""))
    if quality.true_count is None or quality.false_count is None:
        return Tile(
            label, UNDEFINED, f"{quality.accepted_count} accepted; {evaluation.unavailable.get('closures', '')}"
        )
    note = f"{quality.true_count} true, {quality.false_count} false"
    if quality.undecided_count:
        note += f", {quality.undecided_count} undecided"
    return Tile(label, format_percent(quality.precision), f"{note}, of {quality.candidate_count} candidates")


def _recall(evaluation: Evaluation) -> Tile:
    revisits, label = (evaluation.closures.revisits if evaluation.closures else None), "Closure recall"
    if revisits is None:
        return Tile(label, UNDEFINED, evaluation.unavailable.get("closures", ""))
    if not revisits.revisit_count:
        return Tile(label, UNDEFINED, "the drive comes back to no earlier place")
    directions = ", ".join(f"{count} {name}" for name, count in revisits.revisit_counts.items() if count)
    return Tile(
        label,
        format_percent(revisits.recall),
        f"{revisits.recalled_count} of {revisits.revisit_count} ({directions})",
    )


def _landmarks(records: EvaluationRecords, evaluation: Evaluation) -> Tile:
    quality, label = evaluation.landmarks, "Landmarks"
    if quality is not None:
        error = quality.global_frame
        off = f"off by {format_metres(error.median_m, 2)} in the median; " if error else ""
        found = "" if quality.recall is None else f"; {format_percent(quality.recall)} of the objects found"
        right = format_percent(quality.precision)
        seen = "seen on this drive; " if records.has_prior_map else ""
        return Tile(label, str(quality.confirmed_count), f"{seen}{off}{right} show an object{found}")
    if records.object_map is None:
        return Tile(label, UNDEFINED, evaluation.unavailable.get("landmarks", ""))
    confirmed = sum(state == CONFIRMED for state in records.object_map.states)
    classes = {
        label
        for label, state in zip(records.object_map.labels, records.object_map.states, strict=True)
        if state == CONFIRMED
    }
    return Tile(
        label,
        str(confirmed),
        f"confirmed, of {len(classes)} class{'' if len(classes) == 1 else 'es'}; nothing to compare them with",
    )


def _relocalization(evaluation: Evaluation) -> Tile:
    quality, label = evaluation.relocalization, "Relocalization"
    if quality is None:
        return Tile(label, UNDEFINED, evaluation.unavailable.get("relocalization", ""))
    if not quality.loss_count:
        return Tile(label, UNDEFINED, "the robot was never lost")
    times = "once" if quality.loss_count == 1 else f"{quality.loss_count} times"
    note = f"lost {times}; fixes: {quality.right_count} right, {quality.wrong_count} wrong"
    if quality.median_distance_m is not None:
        note += f"; median travel to a fix {format_metres(quality.median_distance_m, 2)}"
    return Tile(label, format_percent(quality.success_rate), note)
