"""dslam train."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json

if TYPE_CHECKING:
    from rich.table import Table

    from descriptors.descriptellation.training import Epoch
    from descriptors.descriptellation_lr.training_maps import TrainingMap

TOWERS = "descriptellation_lr"


def train(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="For the checkpoint, the curves and the weights.", show_default=False),
    ],
    network: Annotated[
        str, typer.Option(metavar="descriptellation_lr|descriptellation|pointnet|sgnet", help="What is trained.")
    ] = TOWERS,
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
            help="What descriptellation is given of an object; position leaves its class out.",
            show_default=False,
        ),
    ] = None,
    epochs: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Of descriptellation_lr 50 maps each, 8 of them, with --maps 4; of the others all data, 100 times.",
        ),
    ] = None,
    anew: Annotated[
        bool, typer.Option("--anew", help="With --maps: begin with random weights instead of the shipped ones.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the data and of the first weights.")] = 0,
    device: Annotated[str, typer.Option(help="As torch names it: cpu, cuda, ...; descriptellation_lr: cpu.")] = "cpu",
    threads: Annotated[int, typer.Option(min=1, help="Of a CPU; another number gives slightly other weights.")] = 2,
    json: Json = False,
) -> None:
    """Train a descriptor network on simulated maps, and descriptellation_lr on maps of your own, too.

    With maps of your own the shipped weights are trained further, and kept where that makes nothing better there.

    A training that was interrupted goes on from its last epoch when the same command is given again. The weights are
    those of the epoch with the best top 5 on validation maps; 'dslam replay --set
    loop_closure.descriptor=FOLDER/weights.safetensors' uses them.

    Example: dslam train out/lr --maps town.csv
    """
    if network == TOWERS:
        if input_kind is not None or device != "cpu":
            raise typer.BadParameter(f"--input and --device belong to the other networks, not to {TOWERS}.")
        if anew and not maps:
            raise typer.BadParameter("it goes with --maps.", param_hint="--anew")
        _train_towers(folder, maps or [], epochs, seed, threads, anew=anew, json=json)
        return
    if maps or anew:
        raise typer.BadParameter(f"--maps, --anew: {network} is trained on simulated maps alone; leave them out.")
    _train_network(folder, network, input_kind, epochs or 100, seed, device, threads, json=json)


def _train_towers(
    folder: Path, maps: list[Path], epochs: int | None, seed: int, threads: int, *, anew: bool, json: bool
) -> None:
    from dataclasses import asdict, replace

    from descriptors.descriptellation_lr.training import (
        Step,
        TowersTraining,
        best_epoch,
        further_training,
        train_towers,
    )
    from descriptors.learned.training_folder import WEIGHTS
    from descriptors.registry import SHIPPED, WEIGHTS_SUFFIX
    from tools import console

    start = SHIPPED / f"{TOWERS}{WEIGHTS_SUFFIX}" if maps and not anew else None
    config = TowersTraining(seed=seed) if start is None else further_training(seed=seed)
    if epochs is not None:
        config = replace(config, epochs=epochs)
    given = [_load_map(path) for path in maps]
    with console.progress_line(f"training {TOWERS}") as tell:

        def report(step: Step) -> None:
            if tell is not None:
                tell(step.done, _progress(step.loss, step.remaining_s))

        history = train_towers(config, folder, given, start=start, threads=threads, on_step=report)
    best = best_epoch(history)
    if json:
        console.show_json({"weights": str(folder / WEIGHTS), "best": asdict(best), "epochs": history[-1].epoch})
        return
    headings = ("epoch", "train loss", "validation loss", "top 1", "top 5", "top 25", "top 5, exact views", "s")
    table = console.grid(dict.fromkeys(headings, True))
    for epoch in history:
        shares = (epoch.validation_top_1, epoch.validation_top_5, epoch.validation_top_25, epoch.exact_top_5)
        table.add_row(
            str(epoch.epoch),
            "-" if epoch.train_loss is None else f"{epoch.train_loss:.3f}",
            f"{epoch.validation_loss:.3f}",
            *(f"{100 * share:.1f} %" for share in shares),
            f"{epoch.seconds:.0f}",
        )
    console.show(table, f"weights of epoch {best.epoch}: {folder / WEIGHTS}")


def _load_map(path: Path) -> TrainingMap:
    """The objects of a CSV file, of a saved map, or of the final map in a log."""
    import numpy as np

    from descriptors.descriptellation_lr.training_maps import TrainingMap
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


def _progress(loss: float, remaining_s: float) -> str:
    minutes, seconds = divmod(round(remaining_s), 60)
    return f"loss {loss:.3f}, {minutes} min {seconds:02d} s left"


def _train_network(
    folder: Path,
    network: str,
    input_kind: str | None,
    epochs: int,
    seed: int,
    device: str,
    threads: int,
    *,
    json: bool,
) -> None:
    from dataclasses import asdict

    from descriptors.descriptellation.training import TrainingConfig, train_network
    from descriptors.learned.architectures import default_architecture
    from descriptors.learned.training_folder import WEIGHTS
    from tools import console

    settings = {} if input_kind is None else {"input": input_kind}
    config = TrainingConfig(architecture=default_architecture(network, **settings), epochs=epochs, seed=seed)
    with console.progress_line(f"training {network}") as tell:

        def report(done: float, loss: float, remaining_s: float) -> None:
            if tell is not None:
                tell(done, _progress(loss, remaining_s))

        history = train_network(config, folder, device=device, threads=threads, on_batch=report)
    best = max(history, key=lambda epoch: epoch.validation_top_k)
    if json:
        console.show_json({"weights": str(folder / WEIGHTS), "best": asdict(best), "epochs": len(history)})
        return
    console.show(_table(history, best.epoch), f"weights of epoch {best.epoch}: {folder / WEIGHTS}")


def _table(history: list[Epoch], best: int) -> Table:
    from tools import console

    headings = ("epoch", "train loss", "validation loss", "train top 5", "validation top 5", "s")
    table = console.grid(dict.fromkeys(headings, True))
    step = max(1, len(history) // 20)
    for epoch in history:
        if epoch.epoch % step == 0 or epoch.epoch in (1, best, len(history)):
            table.add_row(
                str(epoch.epoch),
                f"{epoch.train_loss:.4f}",
                f"{epoch.validation_loss:.4f}",
                f"{100 * epoch.train_top_k:.1f} %",
                f"{100 * epoch.validation_top_k:.1f} %",
                f"{epoch.seconds:.0f}",
            )
    return table
