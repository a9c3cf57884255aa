"""dslam train."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json

if TYPE_CHECKING:
    from rich.table import Table

    from descriptors.descriptellation.training import Epoch


def train(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="For the checkpoint, the curves and the weights.", show_default=False),
    ],
    network: Annotated[
        str, typer.Option(metavar="descriptellation|pointnet|sgnet", help="What is trained.")
    ] = "descriptellation",
    input_kind: Annotated[
        str | None,
        typer.Option(
            "--input",
            metavar="embedding|one_hot|integer|position",
            help="What descriptellation is told of an object; position leaves its class out.",
            show_default=False,
        ),
    ] = None,
    epochs: Annotated[int, typer.Option(min=1, help="How often all of the data are gone through.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Of the data and of the first weights.")] = 0,
    device: Annotated[str, typer.Option(help="As torch names it: cpu, cuda, ...")] = "cpu",
    threads: Annotated[int, typer.Option(min=1, help="Of a CPU; another number gives slightly other weights.")] = 2,
    json: Json = False,
) -> None:
    """Train a descriptor network on simulated maps.

    A training that was interrupted goes on from its last epoch when the same command is given again. The weights are
    those of the epoch with the best top-5 ratio on the validation maps. About half an hour on two cores.

    Example: dslam train out/descriptellation --epochs 20
    """
    from dataclasses import asdict

    from descriptors.descriptellation.training import WEIGHTS, TrainingConfig, train_network
    from descriptors.learned.architectures import default_architecture
    from tools import console

    settings = {} if input_kind is None else {"input": input_kind}
    config = TrainingConfig(architecture=default_architecture(network, **settings), epochs=epochs, seed=seed)
    with console.progress_bar(f"training {network}", "training") as move:

        def report(epoch: Epoch) -> None:
            if move is not None:
                move(epoch.epoch / epochs)

        history = train_network(config, folder, device=device, threads=threads, on_epoch=report)
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
