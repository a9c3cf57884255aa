"""Networks by their architectures: those that ship, and a user's own module as ``file:Class``; descriptors by them."""

from pathlib import Path

import numpy as np
import torch
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from descriptors.arrays import Float32Array
from descriptors.constellation import Constellations
from descriptors.descriptellation.network import Descriptellation, DescriptellationArchitecture
from descriptors.descriptellation_lr.network import DescriptellationLR
from descriptors.descriptellation_lr.pairs import DescriptellationLRArchitecture
from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.weights import make_architecture, read_weights
from descriptors.own_class import make_own


@dataclass(frozen=True, slots=True, config=ConfigDict(extra="forbid"))
class OwnArchitecture:
    """A module of a user's own, ``name`` as ``file:Class``, with the ``length`` of its vectors."""

    name: str
    length: int
    vocabulary_size: int = 64
    radius_m: float = 30.0


VectorArchitecture = DescriptellationArchitecture | OwnArchitecture
"""Of a network that describes constellations by vectors."""
Architecture = VectorArchitecture | DescriptellationLRArchitecture
BATCH = 256
"""Constellations that are described at a time."""
_SHIPPED = {each.name: each for each in (DescriptellationLRArchitecture(), DescriptellationArchitecture())}


def default_architecture(name: str) -> Architecture:
    """The architecture of that name with its default sizes.

    Raises:
        DescriptorError: a name that does not exist, or a module that cannot be trained.
    """
    if ":" in name:
        return OwnArchitecture(name, _make_own_network(name).length)  # type: ignore[arg-type]
    if name not in _SHIPPED:
        raise DescriptorError(
            f"unknown network {name!r}; choose {', '.join(_SHIPPED)}, or a module of your own (module:Class)"
        )
    return _SHIPPED[name]


def make_network(architecture: Architecture) -> nn.Module:
    """The network of that ``architecture``, which is its attribute, with random weights from torch's generator.

    Raises:
        DescriptorError: the module of a user cannot be made.
    """
    if isinstance(architecture, DescriptellationLRArchitecture):
        return DescriptellationLR(architecture)
    if isinstance(architecture, DescriptellationArchitecture):
        return Descriptellation(architecture)
    network = _make_own_network(architecture.name)
    network.architecture = architecture  # type: ignore[assignment]
    return network


def load_network(path: Path) -> nn.Module:
    """The network of a file in evaluation mode; torch's generator is left alone.

    Raises:
        WeightsError: no such file, or one that is damaged or at odds with its architecture.
    """
    weights = read_weights(path)
    tensors = {name: torch.from_numpy(tensor.copy()) for name, tensor in weights.tensors.items()}
    try:
        kind = type(default_architecture(str(weights.architecture.get("name"))))
        with torch.device("meta"):  # neither memory nor random numbers for weights to be replaced
            network = make_network(make_architecture(path, kind, weights.architecture))
        network.to_empty(device="cpu").load_state_dict(tensors)
    except (DescriptorError, RuntimeError) as error:
        raise WeightsError(f"{path}: {' '.join(str(error).split())}") from error
    return network.eval()


def vectors_of(network: nn.Module, constellations: Constellations) -> Tensor:
    """Vectors (B, length) of a network.

    Raises:
        DescriptorError: it returns anything else, or numbers that are not finite.
    """
    architecture: VectorArchitecture = network.architecture  # type: ignore[assignment]
    device = next(network.parameters()).device
    padded = [tensor.to(device) for tensor in pad_constellations(constellations)]
    try:
        vectors: Tensor = network(*padded)
        shape, expected = tuple(vectors.shape), (len(constellations), architecture.length)
    except (RuntimeError, AttributeError, TypeError, IndexError) as error:
        raise DescriptorError(f"{architecture.name}: fails: {str(error).splitlines()[0]}") from error
    if shape != expected:
        raise DescriptorError(
            f"{architecture.name}: returns shape {shape} for {len(constellations)} constellations; give {expected}"
        )
    if not torch.isfinite(vectors).all():
        raise DescriptorError(f"{architecture.name}: returns numbers that are not finite")
    return vectors


def pad_constellations(constellations: Constellations) -> tuple[Tensor, Tensor, Tensor]:
    """Positions (B, N, 3) float32 m, labels (B, N) and presence (B, N) of the objects, the centre first.

    Positions are relative to the centre. Positions and labels are 0 where no object is.
    """
    counts = np.diff(constellations.offsets)
    shape = (len(constellations), int(counts.max(initial=0)) + 1)
    positions = np.zeros((*shape, 3), dtype=np.float32)
    labels = np.zeros(shape, dtype=np.int64)
    places = np.arange(shape[1])
    present = places <= counts[:, None]
    others = present & (places > 0)
    positions[others] = constellations.positions
    labels[others] = constellations.labels
    labels[:, 0] = constellations.centre_labels
    return torch.from_numpy(positions), torch.from_numpy(labels), torch.from_numpy(present)


def _make_own_network(name: str) -> nn.Module:
    """The module of that name.

    Raises:
        DescriptorError: it cannot be made, is no module, or has no length.
    """
    network = make_own(name)
    if not isinstance(network, nn.Module):
        raise DescriptorError(f"{name}: is not a torch.nn.Module")
    if not list(network.parameters()):
        raise DescriptorError(f"{name}: has no weights to train")
    if not isinstance(getattr(network, "length", None), int):
        raise DescriptorError(f"{name}: has no length, the number of values of a descriptor")
    return network


class LearnedDescriptor:
    """A network with its weights; the radius is the one it was trained with.

    A class enters as the row of the embedding that has its place in the vocabulary. Rows mean nothing of their own,
    since the network was trained on classes that were dealt out anew in every map.
    """

    def __init__(self, path: Path) -> None:
        """Load a weights file.

        Raises:
            WeightsError: the file is missing, damaged or at odds with its architecture.
        """
        self._network = load_network(path)
        self._architecture: VectorArchitecture = self._network.architecture  # type: ignore[assignment]
        self.name, self.radius_m = self._architecture.name, self._architecture.radius_m

    def describe(self, constellations: Constellations) -> Float32Array:
        """Vectors (B, length).

        Raises:
            DescriptorError: more classes than the embedding has rows.
        """
        labels = np.concatenate([constellations.labels, constellations.centre_labels])
        if labels.max(initial=0) >= self._architecture.vocabulary_size:
            raise DescriptorError(
                f"labels {labels.min()} to {labels.max()} in a network for {self._architecture.vocabulary_size} "
                "classes: merge rare classes of the vocabulary, or train with a larger vocabulary_size"
            )
        described = np.zeros((len(constellations), self._architecture.length), dtype=np.float32)
        # Batches of about equal size need little padding.
        order = np.argsort(np.diff(constellations.offsets), kind="stable")
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # sums over threads would differ from machine to machine
        try:
            with torch.no_grad():
                for start in range(0, len(order), BATCH):
                    rows = order[start : start + BATCH]
                    described[rows] = vectors_of(self._network, constellations[rows]).numpy()
        finally:
            torch.set_num_threads(threads)
        return described
