"""dslam view."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import check_outputs


def view(
    log: Annotated[
        Path,
        typer.Argument(metavar="OUT.mcap", help="A log that 'dslam replay' wrote, or any map."),
    ],
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.rrd|FILE.png|FILE.json",
            help="Write a Rerun recording, a picture from above, or a layout for Foxglove, instead of showing it.",
        ),
    ] = None,
) -> None:
    """Show a mapped drive in Rerun (map, path, closures and submap at any of its times), or the landmarks of a map.

    Needs Rerun: pip install 'descriptellation-slam[view]'. The viewer listens on this machine only.

    Example: dslam view map.mcap
    """
    check_outputs([save], [log])
    if save is not None and save.suffix not in (".rrd", ".png", ".json"):
        raise typer.BadParameter(f"{save} does not end with .rrd, .png or .json.", param_hint="--save")
    from logs.reader import LogReader
    from logs.storage.placement import replacing, write_text
    from slam.display import rerun_view
    from slam.display.map_topics import PATH
    from slam.object_map.map_io import POINTS_TOPIC
    from tools import console
    from tools.pictures import draw_drive, draw_landmarks

    with LogReader(log) as reader:
        topics = {info.topic for info in reader.topics()}
    if not {PATH, POINTS_TOPIC} & topics:
        raise typer.BadParameter(
            f"{log} has no topic {PATH}; give a log that 'dslam replay' wrote, or a map that this version made."
        )
    if save is not None and save.suffix == ".png":
        (draw_drive if PATH in topics else draw_landmarks)(log, save)
        console.show(str(save))
        return
    if save is not None and save.suffix == ".json":
        layout = Path(rerun_view.__file__).parent / "layouts" / "foxglove.json"
        write_text(save, layout.read_text(encoding="utf-8"))
        console.show(f"{save}: import it in Foxglove, with {log} open")
        return
    os.environ.setdefault("NO_COLOR", "1")  # messages of Rerun are plain text
    if save is not None:
        with replacing(save) as part:
            rerun_view.write_recording(part, log)
        console.show(f"{save}: open it with 'rerun {save}'")
        return
    from tempfile import TemporaryDirectory

    from slam.display.rerun_viewer import show_recording

    with TemporaryDirectory() as folder:
        recording = Path(folder) / f"{log.stem}.rrd"
        rerun_view.write_recording(recording, log)
        show_recording(recording)
