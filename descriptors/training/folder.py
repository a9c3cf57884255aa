"""The folder of a training: the weights of the best epoch, and the curves."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

WEIGHTS, CURVES = "weights.safetensors", "curves.csv"


@dataclass(frozen=True, slots=True)
class Epoch:
    """What an epoch achieved: the mean loss of its steps, and figures of the validation by their names.

    ``epoch`` 0: the weights from which a training went on, with no ``train_loss``.
    """

    epoch: int
    train_loss: float | None
    metrics: Mapping[str, float]
    seconds: float

    def as_row(self) -> dict[str, float | None]:
        """All figures in one level; metrics between the loss and the time."""
        return {"epoch": self.epoch, "train_loss": self.train_loss, **self.metrics, "seconds": self.seconds}


def write_curves(folder: Path, epochs: Sequence[Epoch]) -> None:
    """Write the figures of the epochs so far, one a row."""
    part = folder / f"{CURVES}.part"
    pd.DataFrame([each.as_row() for each in epochs]).to_csv(part, index=False, lineterminator="\n")
    os.replace(part, folder / CURVES)
