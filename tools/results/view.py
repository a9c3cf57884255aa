"""dslam view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import SlamLog, check_outputs


def view(
    log: SlamLog,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FILE.rrd", help="Write a recording with its layout instead of showing it."),
    ] = None,
) -> None:
    """Show a mapped drive in Rerun: map, path, closures and submap at any of its times.

    Needs Rerun: pip install 'descriptellation-slam[view]'. The viewer listens on this machine only.

    Example: dslam view map.mcap
    """
    check_outputs([save], [log])
    from logs.reader import LogReader
    from slam.display import rerun_view
    from slam.display.map_topics import PATH
    from tools import console

    with LogReader(log) as reader:
        if PATH not in {info.topic for info in reader.topics()}:
            raise typer.BadParameter(f"{log} has no topic {PATH}; give a log that 'dslam replay' wrote.")
    rerun_view.import_rerun()
    import rerun as rr

    recording = rr.RecordingStream(rerun_view.APPLICATION, recording_id=log.stem)
    layout = rerun_view.blueprint_of(log)
    if save is not None:
        recording.save(save, default_blueprint=layout)
        rerun_view.send_log(log, recording)
        recording.disconnect()
        console.show(f"{save}: open it by 'rerun {save}'")
        return
    from slam.display.rerun_viewer import start_viewer

    _, address = start_viewer()
    recording.connect_grpc(address, default_blueprint=layout)
    rerun_view.send_log(log, recording)
    recording.disconnect()
    console.show(f"{log} is shown in Rerun; the window stays open")
