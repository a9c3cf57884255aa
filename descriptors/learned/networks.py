"""The networks there are, by name, how one is built, and how it describes constellations.

A new one: a frozen dataclass with ``name``, ``vocabulary_size`` and ``length`` and with defaults that JSON can hold, a
module that takes it and keeps it as ``architecture``, and their line in ``NETWORKS``. One of a user's own is a module
as ``file:Class`` that takes nothing and has a ``length``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from descriptors.baselines.pointnet import PointNet, PointNetArchitecture
from descriptors.baselines.sgnet import SGNet, SGNetArchitecture
from descriptors.descriptellation.network import Descriptellation, DescriptellationArchitecture
from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.padded import PaddedConstellations
from descriptors.learned.weights import Weights, check_tensors, make_architecture, read_weights
from descriptors.own_class import is_own_class, make_own

BATCH = 256
"""Constellations that are described at a time."""


class Architecture(Protocol):
    """What all architectures define."""

    @property
    def name(self) -> str:
        """Its name in the registry."""
        ...

    @property
    def vocabulary_size(self) -> int:
        """How many classes it can tell apart."""
        ...

    @property
    def length(self) -> int:
        """How many numbers a descriptor has."""
        ...


NETWORKS: dict[str, tuple[type[Any], type[nn.Module]]] = {
    "descriptellation": (DescriptellationArchitecture, Descriptellation),
    "pointnet": (PointNetArchitecture, PointNet),
    "sgnet": (SGNetArchitecture, SGNet),
}
_FORMER = {"descriptellation_paper": "descriptellation"}


def read_architecture(values: Mapping[str, object]) -> Architecture:
    """The architecture with exactly these fields, ``name`` among them.

    Raises:
        DescriptorError: a name that does not exist, or fields that are unknown, missing or of the wrong type.
    """
    made: Architecture = make_architecture(_named(values.get("name"))[0], values)
    return made


def default_architecture(name: str, **settings: object) -> Architecture:
    """The architecture of that name with its default sizes, ``settings`` changed.

    Raises:
        DescriptorError: a name that does not exist, or settings that are unknown or of the wrong type.
    """
    if is_own_class(name):
        return read_architecture({**asdict(OwnArchitecture(name, int(_made(name).length))), **settings})  # type: ignore[arg-type]
    return read_architecture({**asdict(_named(name)[0]()), **settings})


def make_network(architecture: Architecture) -> nn.Module:
    """The network of that architecture, with random weights from torch's generator.

    Raises:
        DescriptorError: an architecture that is not registered.
    """
    return _named(architecture.name)[1](architecture)


def load_network(path: Path) -> tuple[nn.Module, Weights]:
    """The network of a file in evaluation mode, and the weights; torch's generator is left alone.

    Raises:
        WeightsError: no such file, or one that is damaged or at odds with its architecture.
    """
    weights = read_weights(path)
    try:
        architecture = read_architecture(weights.architecture)
    except DescriptorError as error:
        raise WeightsError(f"{path}: {error}") from error
    with torch.device("meta"):  # shapes alone: neither memory nor random numbers for weights to be replaced
        network = make_network(architecture)
    expected = {name: (tuple(t.shape), str(t.dtype).removeprefix("torch.")) for name, t in network.state_dict().items()}
    check_tensors(path, weights, expected)
    tensors = {name: torch.from_numpy(tensor.copy()) for name, tensor in weights.tensors.items()}
    network.load_state_dict(tensors, assign=True)
    return network.eval(), weights


def tensors_of(constellations: PaddedConstellations, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Positions, labels and presence as networks take them."""
    return (
        torch.as_tensor(constellations.positions, device=device),
        torch.as_tensor(constellations.labels, device=device),
        torch.as_tensor(constellations.present, device=device),
    )


def vectors_of(network: nn.Module, constellations: PaddedConstellations, device: torch.device) -> Tensor:
    """Vectors (B, length) of a network.

    Raises:
        DescriptorError: it returns anything else, or numbers that are not finite.
    """
    architecture: Architecture = network.architecture  # type: ignore[assignment]
    try:
        vectors: Tensor = network(*tensors_of(constellations, device))
        shape, expected = tuple(vectors.shape), (len(constellations), architecture.length)
    except (RuntimeError, AttributeError, TypeError, IndexError) as error:
        raise DescriptorError(f"{architecture.name}: fails: {str(error).splitlines()[0]}") from error
    if shape != expected:
        raise DescriptorError(
            f"{architecture.name}: returns shape {shape} for {len(constellations)} constellations; give {expected}"
        )
    if not bool(torch.isfinite(vectors).all()):
        raise DescriptorError(f"{architecture.name}: returns numbers that are not finite")
    return vectors


def describe_padded(
    network: nn.Module, constellations: PaddedConstellations, device: torch.device
) -> NDArray[np.float32]:
    """Vectors (B, length) of a network in evaluation mode."""
    sizes = constellations.present.sum(axis=1)
    order = np.argsort(sizes, kind="stable")  # batches of about equal size need little padding
    described = [np.zeros((0, int(network.architecture.length)), dtype=np.float32)]  # type: ignore[union-attr, arg-type]
    with torch.no_grad():
        for start in range(0, len(order), BATCH):
            vectors = vectors_of(network, constellations[order[start : start + BATCH]], device)
            described.append(vectors.cpu().numpy().astype(np.float32))
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(order))
    return np.asarray(np.concatenate(described)[ranks])


@dataclass(frozen=True, slots=True)
class OwnArchitecture:
    """A module of a user's own, ``name`` as ``file:Class``."""

    name: str
    length: int
    vocabulary_size: int = 64


def _own_network(architecture: OwnArchitecture) -> nn.Module:
    network = _made(architecture.name)
    network.architecture = architecture  # type: ignore[assignment]
    return network


def _made(name: str) -> nn.Module:
    """The module of that name.

    Raises:
        DescriptorError: it cannot be made, is no module, or has no length.
    """
    network = make_own(name)
    if not isinstance(network, nn.Module):
        raise DescriptorError(f"{name}: is not a torch.nn.Module")
    if not any(True for _ in network.parameters()):
        raise DescriptorError(f"{name}: has no weights to train")
    if not isinstance(getattr(network, "length", None), int):
        raise DescriptorError(f"{name}: has no length, the number of values of a descriptor")
    return network


def _named(name: object) -> tuple[type[Any], Callable[[Any], nn.Module]]:
    if isinstance(name, str) and is_own_class(name):
        return OwnArchitecture, _own_network
    if isinstance(name, str) and name in NETWORKS:
        return NETWORKS[name]
    if isinstance(name, str) and name in _FORMER:
        raise DescriptorError(f"no architecture {name!r}; it is called {_FORMER[name]!r} now")
    raise DescriptorError(f"no architecture {name!r}; there are {', '.join(NETWORKS)}")
