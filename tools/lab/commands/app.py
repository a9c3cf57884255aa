"""dslam benchmark."""

from __future__ import annotations

import typer

from tools.lab.commands import (
    ablation,
    descriptors,
    faults,
    fleet,
    kidnapping,
    recall,
    relocalization,
    replay,
    retrieval,
    robots,
)
from tools.lab.live.command import live

app = typer.Typer(help="Measure accuracy, recall, speed and memory.", no_args_is_help=True)
app.command()(descriptors.descriptors)
app.command()(faults.faults)
app.command()(fleet.fleet)
app.command()(kidnapping.kidnapping)
app.command()(ablation.ablation)
app.command()(live)
app.command()(recall.recall)
app.command()(relocalization.relocalization)
app.command()(replay.replay)
app.command()(retrieval.retrieval)
app.command()(robots.robots)


@app.callback()
def _benchmark() -> None:
    """Measure accuracy, recall, speed and memory."""
