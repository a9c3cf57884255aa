"""The folder of a training: the weights of the best epoch, the curves, and a checkpoint from which it is resumed."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from descriptors.errors import DescriptorError

CHECKPOINT, WEIGHTS, CURVES = "checkpoint.pt", "weights.safetensors", "curves.csv"
DIGEST_BYTES = 64
"""Of the SHA-256 in hexadecimal digits at the start of a checkpoint. An optimizer accepts an altered state, and fails
when it is used."""


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


@dataclass(frozen=True, slots=True)
class TrainingFolder:
    """A folder, made if it does not exist; ``identity``: what is trained on what, as JSON holds it."""

    path: Path
    identity: Mapping[str, Any]

    @property
    def weights(self) -> Path:
        """Where the weights of the best epoch are."""
        return self.path / WEIGHTS

    def save(self, epochs: Sequence[Epoch], state: Mapping[str, Any]) -> None:
        """Write the curves and the checkpoint after an epoch: ``epochs`` so far, the last one included."""
        with _replaced(self.path / CURVES) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(epochs[-1].as_row()))
            writer.writeheader()
            writer.writerows(each.as_row() for each in epochs)
        content = io.BytesIO()
        done = json.dumps([[each.epoch, each.train_loss, each.metrics, each.seconds] for each in epochs])
        torch.save({"identity": json.dumps(self.identity, sort_keys=True), "epochs": done, **state}, content)
        with _replaced(self.path / CHECKPOINT) as part:
            part.write_bytes(_digest(content.getvalue()) + content.getvalue())

    def resume(self, restore: Callable[[Mapping[str, Any]], None], device: torch.device) -> list[Epoch]:
        """Restore the state of the checkpoint; returns the epochs before it, none without a checkpoint.

        Raises:
            DescriptorError: it is of another training, or cannot be read.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        path = self.path / CHECKPOINT
        if not path.exists():
            return []
        try:
            content = path.read_bytes()
            if content[:DIGEST_BYTES] != _digest(content[DIGEST_BYTES:]):
                raise ValueError("it was altered, or is of another version")
            state = torch.load(io.BytesIO(content[DIGEST_BYTES:]), map_location=device, weights_only=True)
            theirs = dict(json.loads(state["identity"]))
            epochs = [Epoch(*each) for each in json.loads(state["epochs"])]
        except Exception as error:  # what torch raises depends on where the file is broken
            raise DescriptorError(f"{path}: cannot be read: {error}; delete it to start again") from error
        ours = json.loads(json.dumps(self.identity))
        others = sorted(key for key in ours if theirs.get(key) != ours[key])
        if others:
            raise DescriptorError(
                f"{path}: from a run with another configuration ({', '.join(others)}); choose another folder or "
                "delete it to start again"
            )
        restore(state)
        return epochs


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


@contextmanager
def _replaced(path: Path) -> Iterator[Path]:
    """A file to be written, which takes the place of ``path`` once it is whole."""
    part = path.with_name(path.name + ".part")
    yield part
    os.replace(part, path)
