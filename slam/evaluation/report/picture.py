"""What a map looks like, from the records of a log and their evaluation."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.metrics.landmarks import CONFIRMED
from slam.evaluation.place_recognition.closures import ClosureQuality
from slam.evaluation.report.map_frame import MapPaths, bring_into_map
from slam.evaluation.result import Evaluation
from slam.visualization.map_plot import MapPicture


def compose_picture(records: EvaluationRecords, evaluation: Evaluation, *, title: str = "Object map") -> MapPicture:
    """Bring all into the map frame, as :func:`slam.evaluation.report.map_frame.bring_into_map` does.

    A closure joins the estimated positions of its two keyframes.
    """
    paths = bring_into_map(records, evaluation)
    errors = evaluation.estimate or evaluation.online
    rows: list[int] = []
    labels: tuple[str, ...] = ()
    if records.object_map is not None:
        rows = [row for row, state in enumerate(records.object_map.states) if state == CONFIRMED]
        labels = records.object_map.labels
    return MapPicture(
        estimate=paths.estimate.positions,
        odometry=paths.odometry,
        truth=paths.truth,
        lost=paths.lost,
        found=paths.found,
        estimate_jumps=paths.estimate_jumps,
        odometry_jumps=paths.odometry_jumps,
        truth_jumps=paths.truth_jumps,
        landmarks=records.object_map.positions[rows] if records.object_map else np.zeros((0, 3)),
        labels=tuple(labels[row] for row in rows),
        title=title,
        ate_m=errors.absolute.rmse_m if errors else None,
        odometry_ate_m=evaluation.odometry.absolute.rmse_m if evaluation.odometry else None,
        **_closures(evaluation.closures, paths),
    )


def _closures(quality: ClosureQuality | None, paths: MapPaths) -> dict[str, FloatArray]:
    """Ends of the accepted closures by their label, and missed revisits, as :class:`MapPicture` takes them."""
    if quality is None:
        return {}
    judged = quality.judged
    ends = paths.closure_ends(judged)
    shown = judged.accepted & np.isfinite(ends).all(axis=(1, 2))
    missed = paths.positions_at(quality.revisits.missed_stamps_ns) if quality.revisits else np.zeros((0, 3))
    return {
        "true_closures": ends[shown & judged.true],
        "false_closures": ends[shown & judged.decided & ~judged.true],
        "closures": ends[shown & ~judged.decided],
        "missed_revisits": missed[np.isfinite(missed).all(axis=1)],
    }
