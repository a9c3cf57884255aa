"""Pictures of drives and maps from above, for commands that have --picture or --save."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam.localization.prior_map import PriorMap


def draw_drive(log: Path, picture: Path, known: PriorMap | None = None) -> None:
    """Draw what a replay mapped; in a ``known`` map the path over the landmarks of that map."""
    from dataclasses import replace

    import numpy as np

    from slam.display.map_picture import draw_map
    from slam.evaluation.evaluate import evaluate
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.report.picture import compose_picture

    records = read_records(log)
    whole = compose_picture(records, evaluate(records), title=log.stem)
    if known is not None:
        positions = known.positions_around(np.concatenate([whole.estimate, whole.landmarks]))
        whole = replace(whole, landmarks=positions[:0], labels=(), known=positions)
    draw_map(picture, whole)


def draw_landmarks(map_log: Path, picture: Path) -> None:
    """Draw the landmarks of a map of any kind."""
    import numpy as np

    from slam.display.map_layers import MapPicture
    from slam.display.map_picture import draw_map
    from slam.library import read_map

    objects = read_map(map_log)
    draw_map(
        picture,
        MapPicture(np.zeros((0, 3)), landmarks=objects.positions, labels=objects.labels, title=map_log.stem),
    )
