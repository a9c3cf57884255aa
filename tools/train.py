"""dslam train."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import Json

if TYPE_CHECKING:
    from descriptors.training.contrast import ContrastTraining
    from descriptors.training.maps import TrainingMap

LIKELIHOOD = "descriptellation_lr"


def train(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the weights and the curves.")],
    network: Annotated[
        str,
        typer.Option(
            metavar="descriptellation_lr|descriptellation|module:Class",
            help="The network to train: a name, or a torch module of your own (module:Class).",
        ),
    ] = LIKELIHOOD,
    maps: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="A map of your own: CSV with x_m,y_m,z_m,class, a saved map, or a log that 'dslam replay' wrote. "
            "Repeatable.",
        ),
    ] = None,
    epochs: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Epochs of 50 maps; by default 40 for descriptellation_lr (4 with --maps), 100 for other networks.",
        ),
    ] = None,
    anew: Annotated[
        bool, typer.Option("--anew", help="With --maps: start from random weights instead of the shipped ones.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the data and of the initial weights.")] = 0,
    device: Annotated[str, typer.Option(help="Device of torch: cpu, cuda, ...")] = "cpu",
    threads: Annotated[
        int, typer.Option(min=1, help="Threads of the CPU; their number changes the weights slightly.")
    ] = 2,
    json: Json = False,
) -> None:
    """Train a descriptor network on simulated maps and on maps of your own.

    With maps of your own, training starts from the shipped weights if the network has any, and keeps them if no epoch
    is better on these maps.

    The weights are those of the epoch with the best top 5 on validation maps; 'dslam replay --set
    loop_closure.descriptor=FOLDER/weights.safetensors' uses them.

    Example: dslam train out/lr --maps town.csv
    """
    from descriptors.registry import LEARNED, shipped_weights
    from descriptors.training.trainer import WEIGHTS, Recipe, best_of
    from descriptors.training.trainer import train as train_recipe
    from tools import console

    if anew and not maps:
        raise typer.BadParameter("use it with --maps.", param_hint="--anew")
    start = shipped_weights(network) if maps and not anew and network in LEARNED else None
    config = _config(network, epochs, seed, is_further=start is not None)
    recipe = Recipe(config, [_load_map(path) for path in maps or ()], start, device=device)
    with console.progress_bar(f"training {network}") as move:
        history = train_recipe(recipe, folder, threads=threads, on_progress=move)
    figures = {"weights": folder / WEIGHTS, "best": best_of(history), "epochs": history[-1]["epoch"]}
    console.report(figures, as_json=json)


def _config(network: str, epochs: int | None, seed: int, *, is_further: bool) -> "ContrastTraining":
    """How a network is trained. Weights that are trained already are trained further in smaller steps, and with more
    validation maps, as the differences between epochs are small.
    """
    from dataclasses import replace

    from descriptors.learned.networks import default_architecture
    from descriptors.training.contrast import ContrastTraining

    config = ContrastTraining(default_architecture(network), seed=seed)
    if network != LIKELIHOOD:
        config = replace(config, epochs=100, learning_rate=1e-3, last_rate=1e-5)
    if is_further:
        rate = 0.1 * config.learning_rate
        config = replace(config, epochs=4, validation_maps=96, learning_rate=rate, last_rate=0.1 * rate)
    return config if epochs is None else replace(config, epochs=epochs)


def _load_map(path: Path) -> "TrainingMap":
    """The objects of a CSV file, of a map of any kind, or of the final map in a log."""
    from descriptors.training.maps import TrainingMap
    from logs.importers.maps.object_table import read_object_table
    from slam.common.errors import InputDataError
    from slam.library import read_map

    objects: Any = read_object_table(path).in_metres() if path.suffix.lower() == ".csv" else read_map(path)
    if not len(objects.labels):
        raise InputDataError(f"{path} holds no object")
    return TrainingMap.of(objects.positions, objects.labels)
