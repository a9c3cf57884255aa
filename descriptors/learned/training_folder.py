"""The folder of a training: the weights of the best epoch, the curves, and a checkpoint from which it goes on."""

from __future__ import annotations

import csv
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import torch

from descriptors.errors import DescriptorError

CHECKPOINT, WEIGHTS, CURVES = "checkpoint.pt", "weights.safetensors", "curves.csv"
E = TypeVar("E")


class Stateful(Protocol):
    """A network, an optimizer, or whatever else changes while it is trained."""

    def state_dict(self) -> Any:
        """Its state: tensors, numbers and texts, nested."""

    def load_state_dict(self, state_dict: Any, /) -> Any:
        """Put it into that state."""


@dataclass(frozen=True, slots=True)
class TrainingFolder(Generic[E]):
    """A folder, made if it does not exist, of a training whose epochs are ``epoch_type``, a flat dataclass.

    ``identity``: what is trained on what, as JSON holds it; ``extendable``: the keys of it that may differ in the
    training that goes on, for example the number of epochs.
    """

    path: Path
    epoch_type: type[E]
    identity: Mapping[str, Any]
    extendable: frozenset[str] = field(default_factory=frozenset)

    @property
    def weights(self) -> Path:
        """Where the weights of the best epoch are."""
        return self.path / WEIGHTS

    def save(self, epochs: Sequence[E], parts: Mapping[str, Stateful]) -> None:
        """Write the curves and the checkpoint after an epoch: ``epochs`` so far, the last one included."""
        rows = [asdict(epoch) for epoch in epochs]  # type: ignore[call-overload]
        with replaced(self.path / CURVES) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=[each.name for each in fields(self.epoch_type)])  # type: ignore[arg-type]
            writer.writeheader()
            writer.writerows(rows)
        state = {
            "identity": json.dumps(self.identity, sort_keys=True),
            "epochs": json.dumps(rows),
            **{name: part.state_dict() for name, part in parts.items()},
        }
        with replaced(self.path / CHECKPOINT) as part:
            torch.save({**state, "sha256": _digest(state)}, part)

    def resume(self, parts: Mapping[str, Stateful], device: torch.device | None = None) -> list[E]:
        """Put the parts into the state of the checkpoint; returns the epochs before it, none without a checkpoint.

        Raises:
            DescriptorError: it is of another training, or cannot be read.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        path = self.path / CHECKPOINT
        if not path.exists():
            return []
        try:
            state = torch.load(path, map_location=device, weights_only=True)
            if state.pop("sha256", None) != _digest(state):
                raise ValueError("it was altered, or is of another version")
            theirs = dict(json.loads(state["identity"]))
            epochs = [self.epoch_type(**each) for each in json.loads(state["epochs"])]
        except Exception as error:  # what torch raises depends on where the file is broken
            raise DescriptorError(f"{path}: cannot be read: {error}; delete it to start anew") from error
        ours = json.loads(json.dumps(self.identity))
        others = sorted(key for key in ours if key not in self.extendable and theirs.get(key) != ours[key])
        if others:
            raise DescriptorError(
                f"{path}: of a training with another configuration ({', '.join(others)}); choose another folder, or "
                "delete it to start anew"
            )
        for name, part in parts.items():
            part.load_state_dict(state[name])
        return epochs


def _digest(state: Mapping[str, Any]) -> str:
    """SHA-256 of all tensors, numbers and texts: an optimizer takes an altered state, and fails when it is used."""
    digest = hashlib.sha256()

    def add(key: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for name, each in value.items():
                add(f"{key}/{name}", each)
        elif isinstance(value, list | tuple):
            for number, each in enumerate(value):
                add(f"{key}/{number}", each)
        elif isinstance(value, torch.Tensor):
            plain = value.detach().cpu().contiguous()
            digest.update(f"{key} {plain.dtype} {tuple(plain.shape)}\n".encode())
            digest.update(plain.reshape(-1).view(torch.uint8).numpy().tobytes())
        else:
            digest.update(f"{key} {value!r}\n".encode(errors="backslashreplace"))

    add("", state)
    return digest.hexdigest()


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A file to be written, which takes the place of ``path`` once it is whole."""
    part = path.with_name(path.name + ".part")
    yield part
    os.replace(part, path)
