"""dslam benchmark."""

import typer

from tools.lab.commands.descriptors import descriptors
from tools.lab.commands.recall import recall
from tools.lab.commands.relocalization import relocalization
from tools.lab.commands.retrieval import retrieval
from tools.lab.commands.robots import robots

app = typer.Typer(help="Measure accuracy, recall, speed and memory.", no_args_is_help=True)
for command in (descriptors, recall, relocalization, retrieval, robots):
    app.command()(command)
