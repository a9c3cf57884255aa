"""Pictures of drives and maps from above, for commands that have --picture or --save."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam.localization.prior_map import PriorMap


def draw_drive(log: Path, picture: Path, known: PriorMap | None = None) -> None:
    """Draw what a replay mapped; in a ``known`` map the path over the landmarks of that map."""
    from slam.display.map_picture import draw_map
    from slam.evaluation.evaluate import evaluate
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.report.picture import compose_picture

    records = read_records(log)
    around = None if known is None else known.positions_around
    draw_map(picture, compose_picture(records, evaluate(records), title=log.stem, known=around))


def draw_landmarks(map_log: Path, picture: Path) -> None:
    """Draw the landmarks of a map of any kind."""
    from slam.display.map_layers import MapPicture, class_layers, count_classes
    from slam.display.map_picture import draw_map
    from slam.library import read_map

    objects = read_map(map_log)
    layers = [*class_layers(objects.positions, objects.labels)]
    draw_map(picture, MapPicture(map_log.stem, count_classes(objects.labels), layers))
