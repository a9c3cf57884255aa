"""Pictures of drives and maps from above, for commands that have --picture or --save."""

from pathlib import Path


def draw_drive(log: Path, picture: Path) -> None:
    """Draw what a replay mapped."""
    from slam.evaluation.evaluate import evaluate
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.report.picture import compose_picture

    records = read_records(log)
    compose_picture(records, evaluate(records), log.stem).save(picture)


def draw_landmarks(map_log: Path, picture: Path) -> None:
    """Draw the landmarks of a map of any kind."""
    from slam.display.map_picture import MapPicture, count_classes
    from slam.library import read_map

    objects = read_map(map_log)
    drawn = MapPicture(map_log.stem, count_classes(objects.labels))
    drawn.add_landmarks(objects.positions, objects.labels)
    drawn.save(picture)
