"""Pictures of drives and maps from above, for commands that have --picture or --save."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from datetime import datetime

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


def draw_changes(city: Path, picture: Path, since: datetime | None, until: datetime | None) -> None:
    """Draw what changed in the map of a fleet, over the landmarks that are there now; of the changes those that a drive
    noticed between two dates (UTC).
    """
    import numpy as np

    from slam.display.map_layers import MapPicture
    from slam.display.map_picture import draw_map
    from slam.fleet.changes import KINDS, read_changes
    from slam.library import read_map

    changes = read_changes(city / "changes.geojson", since, until)
    appeared, gone, moved = ([change for change in changes if change.kind == kind] for kind in KINDS)
    dates = [f"{word} {day:%Y-%m-%d}" for word, day in (("since", since), ("until", until)) if day]
    whole = MapPicture(
        np.zeros((0, 3)),
        known=read_map(city / "map.mcap").positions,
        appeared=np.array([change.position for change in appeared]).reshape(-1, 3),
        gone=np.array([change.position for change in gone]).reshape(-1, 3),
        moved=np.array([(change.from_position, change.position) for change in moved]).reshape(-1, 2, 3),
        title=" ".join([city.resolve().name, *dates]),
    )
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
