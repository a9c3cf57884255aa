"""dslam train."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json

if TYPE_CHECKING:
    from rich.table import Table

    from descriptors.training.folder import Epoch
    from descriptors.training.maps import TrainingMap
    from descriptors.training.trainer import Recipe

LIKELIHOOD = "descriptellation_lr"
MAX_ROWS = 20
"""Epochs in the table, besides the first, the best and the last one."""


def train(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder of the checkpoint, the curves and the weights.", show_default=False
        ),
    ],
    network: Annotated[
        str, typer.Option(metavar="descriptellation_lr|descriptellation|pointnet|sgnet", help="The network to train.")
    ] = LIKELIHOOD,
    maps: Annotated[
        list[Path] | None,
        typer.Option(
            "--maps",
            metavar="FILE",
            help="A map of your own: CSV with x_m,y_m,z_m,class, a saved map, or a log that 'dslam replay' wrote. "
            "Repeatable; descriptellation_lr only.",
        ),
    ] = None,
    input_kind: Annotated[
        str | None,
        typer.Option(
            "--input",
            metavar="embedding|one_hot|integer|position",
            help="Input of descriptellation for each object; position has no class.",
            show_default=False,
        ),
    ] = None,
    epochs: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="By default 8 of 50 maps each for descriptellation_lr (4 with --maps), 100 for other networks.",
        ),
    ] = None,
    anew: Annotated[
        bool, typer.Option("--anew", help="With --maps: start from random weights instead of the shipped ones.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the data and of the initial weights.")] = 0,
    device: Annotated[str, typer.Option(help="Device of torch: cpu, cuda, ...; descriptellation_lr: cpu.")] = "cpu",
    threads: Annotated[
        int, typer.Option(min=1, help="Threads of the CPU; their number changes the weights slightly.")
    ] = 2,
    json: Json = False,
) -> None:
    """Train a descriptor network on simulated maps, and descriptellation_lr on maps of your own, too.

    With maps of your own, training starts from the shipped weights, and keeps them if no epoch is better on these maps.

    After an interruption the same command continues from the last epoch. The weights are
    those of the epoch with the best top 5 on validation maps; 'dslam replay --set
    loop_closure.descriptor=FOLDER/weights.safetensors' uses them.

    Example: dslam train out/lr --maps town.csv
    """
    from descriptors.training.folder import WEIGHTS
    from descriptors.training.trainer import Step
    from descriptors.training.trainer import train as train_recipe
    from tools import console

    if network == LIKELIHOOD:
        if input_kind is not None or device != "cpu":
            raise typer.BadParameter(f"--input and --device belong to the other networks, not to {LIKELIHOOD}.")
        if anew and not maps:
            raise typer.BadParameter("use it with --maps.", param_hint="--anew")
        recipe = _likelihood_recipe(maps or [], epochs, seed, anew=anew)
    else:
        if maps or anew:
            raise typer.BadParameter(f"--maps, --anew: {network} is trained on simulated maps alone; leave them out.")
        recipe = _network_recipe(network, input_kind, epochs, seed, device)
    with console.progress_line(f"training {network}") as tell:

        def report(step: Step) -> None:
            if tell is not None:
                minutes, seconds = divmod(round(step.remaining_s), 60)
                tell(step.done, f"loss {step.loss:.3f}, {minutes} min {seconds:02d} s left")

        history = train_recipe(recipe, folder, threads=threads, on_step=report)
    best = recipe.best(history)
    if json:
        console.show_json({"weights": str(folder / WEIGHTS), "best": best.as_row(), "epochs": history[-1].epoch})
        return
    console.show(_table(history, best), f"weights of epoch {best.epoch}: {folder / WEIGHTS}")


def _likelihood_recipe(maps: list[Path], epochs: int | None, seed: int, *, anew: bool) -> Recipe:
    from dataclasses import replace

    from descriptors.registry import shipped_weights
    from descriptors.training import contrast

    is_further = bool(maps) and not anew
    config = contrast.further_training(seed=seed) if is_further else contrast.ContrastTraining(seed=seed)
    if epochs is not None:
        config = replace(config, epochs=epochs)
    given = [_load_map(path) for path in maps]
    return contrast.ContrastRecipe(config, given, shipped_weights(LIKELIHOOD) if is_further else None)


def _network_recipe(network: str, input_kind: str | None, epochs: int | None, seed: int, device: str) -> Recipe:
    from dataclasses import replace

    from descriptors.learned.networks import default_architecture
    from descriptors.training import triplets

    settings = {} if input_kind is None else {"input": input_kind}
    config = triplets.TripletTraining(architecture=default_architecture(network, **settings), seed=seed)
    return triplets.TripletRecipe(config if epochs is None else replace(config, epochs=epochs), device)


def _load_map(path: Path) -> TrainingMap:
    """The objects of a CSV file, of a saved map, or of the final map in a log."""
    import numpy as np

    from descriptors.training.maps import TrainingMap
    from slam.common.errors import InputDataError

    if path.suffix.lower() == ".csv":
        from logs.importers.maps.object_table import read_object_table

        table = read_object_table(path)
        if table.is_geodetic:
            raise InputDataError(f"{path}: positions in degrees; give metres")
        positions, labels = table.positions, table.labels
    else:
        from logs.reader import LogReader
        from slam.object_map.map_io import METADATA, confirmed, load_map

        with LogReader(path) as reader:
            is_saved = METADATA in reader.metadata()
        if is_saved:
            objects = load_map(path).objects
        else:
            from slam.evaluation.inputs.records import read_records

            record = read_records(path).object_map
            if record is None:
                raise InputDataError(f"{path}: no map in it; give a saved map, or a log that 'dslam replay' wrote")
            objects = confirmed(record)
        positions, labels = objects.positions, objects.class_probabilities.argmax(axis=1)
    found, numbers = np.unique(np.asarray(labels), return_inverse=True)
    return TrainingMap(np.asarray(positions, dtype=np.float64), numbers.astype(np.int64), len(found))


def _table(history: list[Epoch], best: Epoch) -> Table:
    from tools import console

    table = console.grid(dict.fromkeys((name.replace("_", " ") for name in [*best.as_row()]), True))
    step = max(1, len(history) // MAX_ROWS)
    for epoch in history:
        if epoch.epoch % step == 0 or epoch in (history[0], best, history[-1]):
            table.add_row(*(_cell(name, value) for name, value in epoch.as_row().items()))
    return table


def _cell(name: str, value: float | None) -> str:
    if value is None:
        return "-"
    if "top" in name:
        return f"{100 * value:.1f} %"
    return f"{value:.4f}" if "loss" in name else f"{value:.0f}"
