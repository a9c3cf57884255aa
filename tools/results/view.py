"""dslam view."""

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import check_outputs


def view(
    log: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="A log that 'dslam replay' wrote, or any map.")],
    save: Annotated[
        Path, typer.Option(metavar="FILE.png|FILE.json", help="A picture from above, or a layout for Foxglove.")
    ],
) -> None:
    """Draw a mapped drive or the landmarks of a map from above, or write a layout in which Foxglove shows the log.

    Example: dslam view map.mcap --save map.png
    """
    check_outputs([save], [log])
    if save.suffix not in (".png", ".json"):
        raise typer.BadParameter(f"{save} does not end with .png or .json.", param_hint="--save")
    from logs.reader import LogReader
    from logs.storage.placement import write_text
    from slam.display import map_topics
    from tools import console
    from tools.pictures import draw_drive, draw_landmarks

    with LogReader(log) as reader:
        is_drive = map_topics.PATH in {info.topic for info in reader.topics()}
    if save.suffix == ".png":
        (draw_drive if is_drive else draw_landmarks)(log, save)
        console.show(str(save))
        return
    layout = Path(map_topics.__file__).parent / "layouts" / "foxglove.json"
    write_text(save, layout.read_text(encoding="utf-8"))
    console.show(f"{save}: import it in Foxglove, with {log} open")
